"""Real SocketCAN where the host's kernel has none: our tests inside a Debian kernel that QEMU runs.

1. Nothing on the host is changed and no privilege is needed: packages are fetched and unpacked into `build/socketcan`.
2. What cannot run here says why and is skipped, loudly; `--require` makes that a failure.

The guest sees this machine's file system read-only with a layer of memory over it, so it runs the same interpreter, the
same environment and the same sources. It has `vcan0` and `vcan1`. `make test-socketcan` runs this; by hand:

    python tests/socketcan/run.py [--require] [--limit SECONDS] [pytest arguments, or: -- COMMAND …]

*Facts.* Without hardware acceleration the guest is ready after 7 s and Python in it is some 17 times slower: it shows
what is right, not how fast it is. `ACCEL=kvm` where that works. Debian 12 is what this was tried on.
"""

from __future__ import annotations

import argparse
import lzma
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
import threading
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "socketcan"
TESTS = "tests/socketcan/test_socketcan.py"
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "can_raw", "can_bcm", "vcan")
TOOLS = ("apt-get", "apt-cache", "dpkg-deb", "qemu-system-x86_64")

INIT = """#!/busybox sh
B=/busybox
$B mkdir -p /proc /sys /dev /lower /rw /over
$B mount -t proc proc /proc
$B mount -t sysfs sys /sys
$B mount -t devtmpfs dev /dev
while read -r m; do $B insmod /modules/$m || echo "guest: could not load $m"; done < /modules/order
o=trans=virtio,version=9p2000.L,msize=262144
$B mount -t 9p -o ro,cache=loose,$o host /lower
$B mount -t tmpfs rw /rw
$B mkdir -p /rw/upper /rw/work
$B mount -t overlay -o lowerdir=/lower,upperdir=/rw/upper,workdir=/rw/work over /over
cd /over
$B mkdir -p proc sys dev/pts dev/shm run share
for d in proc sys dev; do $B mount -o bind /$d /over/$d; done
$B mkdir -p dev/pts dev/shm
$B mount -t devpts devpts dev/pts
$B mount -t tmpfs shm dev/shm
$B mount -t tmpfs run run
$B mount -t 9p -o cache=mmap,$o share share
$B ifconfig lo 127.0.0.1 up
for i in vcan0 vcan1; do $B ip link add dev $i type vcan && $B ip link set $i mtu 72 && $B ip link set $i up; done
echo "guest: ready after $($B cut -d' ' -f1 /proc/uptime) s, kernel $($B uname -r)"
$B chroot /over /usr/bin/env -i HOME=/tmp TERM=dumb LANG=C.UTF-8 /bin/sh /share/command.sh </dev/null
echo $? > /over/share/status
$B sync
$B poweroff -f
"""


class CannotRun(Exception):
    """Why this machine cannot do it."""


def say(text: str) -> None:
    print(f"[socketcan] {text}", file=sys.stderr, flush=True)


def run(*command: str, cwd: Path | None = None) -> str:
    """What a program says; `CannotRun` with its own words when it fails."""
    try:
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    except subprocess.TimeoutExpired:
        raise CannotRun(f"`{shlex.join(command)}` took more than 300 s") from None
    if done.returncode:
        raise CannotRun(f"`{shlex.join(command)}` failed: {(done.stderr or done.stdout).strip()[-500:]}")
    return done.stdout


# ---------------------------------------------------------------------- packages


def unpacked(package: str) -> Path:
    """The folder into which a Debian package was unpacked, once."""
    folder = WORK / package
    if not (folder / ".done").exists():
        say(f"fetching {package}")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        run("apt-get", "-qq", "download", package, cwd=folder)
        (archive,) = folder.glob("*.deb")
        run("dpkg-deb", "-x", str(archive), str(folder))
        archive.unlink()
        (folder / ".done").touch()
    return folder


def kernel_package() -> str:
    told = os.environ.get("KERNEL_PKG")
    if told:
        return told
    found = re.search(r"Depends: (linux-image-\S+)", run("apt-cache", "depends", "linux-image-amd64"))
    if found is None:
        raise CannotRun(
            "no kernel package is known; run `apt-get update`, or name one: KERNEL_PKG=linux-image-…"
        )
    return found[1]


def unpack(raw: bytes) -> bytes | None:
    """What xz, gzip or (with the zstandard package) zstd have packed."""
    if raw.startswith(b"\xfd7zXZ"):
        return lzma.LZMADecompressor().decompress(raw)
    if raw.startswith(b"\x1f\x8b"):
        return zlib.decompressobj(31).decompress(raw)
    if raw.startswith(b"\x28\xb5\x2f\xfd"):
        try:
            import zstandard
        except ImportError:
            return None
        unpacked: bytes = zstandard.ZstdDecompressor().decompressobj().decompress(raw)
        return unpacked
    return raw


def bootable(image: Path) -> Path:
    """The kernel without its packing, which costs the guest 5 s; the image itself where that is not to be had."""
    plain = image.with_name("vmlinux")
    if not plain.exists():
        raw = image.read_bytes()
        offset, length = struct.unpack_from(
            "<II", raw, 0x248
        )  # x86 boot protocol: payload_offset, payload_length
        start = ((raw[0x1F1] or 4) + 1) * 512 + offset
        elf = unpack(raw[start : start + length])
        if (
            elf is None or not elf.startswith(b"\x7fELF") or b"Xen\0" not in elf
        ):  # QEMU enters at the PVH note
            return image
        plain.write_bytes(elf)
    return plain


def modules(kernel: Path) -> Iterator[tuple[str, bytes]]:
    """The modules and what they need, in the order in which they load."""
    files = {path.name.split(".")[0].replace("-", "_"): path for path in kernel.rglob("*.ko*")}
    done: set[str] = set()

    def load(name: str) -> Iterator[tuple[str, bytes]]:
        if name in done or name not in files:  # not a file: it is built into the kernel
            return
        done.add(name)
        content = unpack(files[name].read_bytes())
        if content is None:
            raise CannotRun("the kernel's modules are packed with zstd: `pip install zstandard`")
        found = re.search(rb"\0depends=([^\0]*)\0", content)
        for other in (found[1].decode() if found else "").split(","):
            yield from load(other.replace("-", "_"))
        yield f"{name}.ko", content

    for name in MODULES:
        yield from load(name)


def archive(files: Sequence[tuple[str, bytes, int]]) -> bytes:
    """Files (name, content, mode) as a cpio archive of the kind a kernel unpacks at its start."""
    out = bytearray()
    for number, (name, content, mode) in enumerate([*files, ("TRAILER!!!", b"", 0)], 1):
        fields = (number, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
        out += b"070701" + "".join(f"{field:08x}" for field in fields).encode() + name.encode() + b"\0"
        out += bytes(-len(out) % 4) + content
        out += bytes(-len(out) % 4)
    return bytes(out)


# ---------------------------------------------------------------------- the guest


def command_line(command: Sequence[str], tools: Path) -> str:
    path = f"{Path(sys.executable).parent}:{tools}/usr/bin:/usr/sbin:/usr/bin:/sbin:/bin:/share/bin"
    lines = [
        f"export PATH={shlex.quote(path)} PYTHONDONTWRITEBYTECODE=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1",
        f"export PYTHONPATH={shlex.quote(':'.join(str(ROOT / part) for part in ('', 'protocols', 'tools', 'devices')))}",
        "export ACES_SOCKETCAN=vcan0,vcan1",
        f"cd {shlex.quote(str(ROOT))}",
        shlex.join(command),
    ]
    return "\n".join(lines) + "\n"


def boot(command: Sequence[str], limit: int) -> int:
    """Run a command in the guest; its status."""
    for tool in TOOLS:
        if shutil.which(tool) is None:
            hint = "`apt-get install qemu-system-x86`" if tool.startswith("qemu") else "this needs Debian"
            raise CannotRun(f"{tool} is missing: {hint}")
    kernel = unpacked(kernel_package())
    (image,) = (kernel / "boot").glob("vmlinuz-*")
    (busybox,) = (path for path in unpacked("busybox-static").glob("**/bin/busybox") if path.is_file())
    tools = unpacked("can-utils")
    loaded = list(modules(kernel))
    order = "".join(f"{name}\n" for name, _ in loaded).encode()
    own = WORK / f"run-{os.getpid()}"
    share = own / "share"
    share.mkdir(parents=True)
    (share / "command.sh").write_text(command_line(command, tools))
    (share / "bin").mkdir()
    shutil.copy(busybox, share / "bin" / "ip")  # where there is no iproute2
    initrd = own / "initrd.img"
    folders = [(name, b"", 0o040755) for name in ("dev", "modules")]
    files = [(f"modules/{name}", content, 0o100644) for name, content in [*loaded, ("order", order)]]
    programs = [("busybox", busybox.read_bytes(), 0o100755), ("init", INIT.encode(), 0o100755)]
    initrd.write_bytes(archive([*folders, *files, *programs]))
    accel = os.environ.get("ACCEL", "tcg")
    say(f"booting {kernel.name} ({accel}); at most {limit} s")
    machine = f"-M pc -m 1024 -smp 1 -accel {accel} -cpu {'host' if accel == 'kvm' else 'max'} -nodefaults"
    machine += " -display none -no-reboot -serial stdio -monitor none -virtfs local,security_model=none,"
    machine += "path=/,mount_tag=host,readonly=on,multidevs=remap"
    words = [*machine.split(), "-virtfs", f"local,security_model=none,path={share},mount_tag=share"]
    words += ["-kernel", str(bootable(image)), "-initrd", str(initrd)]
    process = subprocess.Popen(
        ["qemu-system-x86_64", *words, "-append", "console=ttyS0 quiet panic=-1 mitigations=off audit=0"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    alarm = threading.Timer(limit, process.kill)
    alarm.start()
    is_ready = False
    for line in iter(process.stdout.readline, b""):
        is_ready = is_ready or line.startswith(b"guest: ready")
        sys.stdout.buffer.write(line.replace(b"\r", b""))
        sys.stdout.flush()
    is_late = not alarm.is_alive()
    alarm.cancel()
    process.wait()
    status = share / "status"
    said = status.read_text() if status.exists() else ""
    shutil.rmtree(own, ignore_errors=True)
    if said:
        return int(said)
    if is_ready or is_late:
        say(f"not done after {limit} s" if is_late else "the guest ended before the tests did")
        return 1
    raise CannotRun(f"the guest did not come up (qemu's status {process.returncode}; its words are above)")


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the SocketCAN tests inside a kernel that QEMU runs.")
    parser.add_argument(
        "--require", action="store_true", help="fail where this cannot run, instead of skipping"
    )
    parser.add_argument("--limit", type=int, default=900, metavar="SECONDS", help="at most so long (900)")
    options, rest = parser.parse_known_args()
    if rest[:1] == ["--"]:
        command = rest[1:]
    else:
        # Quick to start: no plugins, no conftest, and not what python-can would import for a format.
        start = "import sys; sys.modules['asammdf'] = None; import pytest; sys.exit(pytest.main())"
        quick = ["-v", "-p", "no:cacheprovider", "--noconftest", "--durations=5"]
        command = [sys.executable, "-c", start, *quick, TESTS, *rest]
    try:
        return boot(command, options.limit)
    except CannotRun as error:
        say(f"SKIPPED, NOTHING WAS TESTED: {error}")
        return 1 if options.require else 0


if __name__ == "__main__":
    sys.exit(main())
