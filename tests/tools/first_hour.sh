#!/usr/bin/env bash
# A newcomer's first hour: a fresh environment with the wheel alone, and what the first three pages say, typed there.
#
#   tests/tools/first_hour.sh        # or `make first-hour`; minutes, as it installs; PYTHON names another interpreter
#
# 1. README.md: each command as the page has it, and a part of what it must print (`says`). Those that need what is not here
#    are `left out`, with the reason. `test_first_hour.py` sees to it that page and script have the same commands.
# 2. docs/tutorial.md and docs/python.md: from the first line to the last, compared with what the pages show.
# 3. Nothing of the repository can be imported while they run.
set -euo pipefail
ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
WORK="$(mktemp -d)"
SERVING=""
trap '[ -z "$SERVING" ] || kill "$SERVING"; rm -rf "$WORK"' EXIT
unset PYTHONPATH PYTHONHOME VIRTUAL_ENV PYTEST_ADDOPTS ACES_ROBOT
export COLUMNS=200 NO_COLOR=1 PYTHONUTF8=1

echo "making a fresh environment"
"${PYTHON:-python3}" -m venv "$WORK/venv"
PATH="$WORK/venv/bin:$PATH"
cd "$WORK"
pip install --quiet --disable-pip-version-check --constraint "$ROOT/constraints.txt" "$ROOT[columns,mf4,plot,testing]"

# says PATTERN COMMAND: what is typed prints this (a plain text), with status 0, or with the one in STATUS.
says() {
  echo "\$ $2"
  local status=0 printed
  printed="$(bash -c "$2" 2>&1 < /dev/null)" || status=$?
  if [ "$status" != "${STATUS:-0}" ] || ! grep -qF -- "$1" <<< "$printed"; then
    printf '%s\nexit status %s; expected: %s\n' "$printed" "$status" "$1" >&2
    exit 1
  fi
}
left_out() { :; } # COMMAND, REASON

# ---------------------------------------------------------------------- README.md

mkdir desk && cd desk
cp -r "$ROOT/examples" examples
cp examples/captures/hubo2plus.log walk.log
cp walk.log any.log
cp examples/captures/robotis_session.bin servo.bin
aces convert walk.log drive.blf -q
aces convert walk.log drive.mf4 -q
aces convert walk.log walk.blf -q
aces spec export hubo@hubo2plus --format dbc -o car.dbc > export.txt 2>&1

left_out 'make demo' 'makes an environment of its own'
says '-p hubo@hubo2plus' 'aces decode any.log'
says 'frames=1243 decoded=1239' 'aces decode walk.log -p hubo'
says 'bytes=' 'aces decode servo.bin -p robotis --direction from'
says 'frames=1243' 'aces decode drive.blf -p car.dbc -o drive.parquet'
says 'frames=1243' "aces plot walk.log -p hubo 'Encoder[board=3].position.*' - 'Current[board=3].*' -o walk.png"
says 'frames=1243' 'aces convert drive.mf4 drive.asc.gz'
says 'messages guessed' 'aces spec guess walk.log --no-known -o draft.py'
STATUS=1 says 'changes=' 'aces diff walk.log --a 0..0.3 --b 0.3..0.6'
left_out 'aces discover -p robotis --bus /dev/ttyUSB0 > found.toml' 'needs a line'
says 'position' 'aces device RHP get -r hubo2plus --virtual'
left_out 'aces device RHP home -r hubo2plus --bus lower=can0 -i socketcan --tx' 'needs a robot'
left_out 'aces stop hubo2plus -i socketcan' 'needs a bus'
left_out 'aces sim -r hubo2plus' 'does not end by itself'
says 'devices are there' 'aces sim -r hubo2plus --for 0.2s' # instead
says 'wrote gripper/gripper.py' 'aces spec new gripper --link can'
says 'ok' 'aces spec check gripper/gripper.py'
left_out 'aces spec check gripper/gripper.py --against walk.log' 'needs a recording of that gripper'
says 'Encoder' "aces spec explain hubo '063#78 00 00 00 FC FF FF FF'"
left_out 'aces fuzz gripper/gripper.py --for 10min' 'takes its time'
says 'no failure' 'aces fuzz gripper/gripper.py --examples 5' # instead
says 'cannot say' 'aces spec export hubo --format c -o hubo.c'
says '' 'aces spec import car.dbc -o car.py'
left_out 'aces sniff can0 -p hubo --record walk.blf' 'does not end by itself'
left_out 'aces sniff can0 -p hubo --screen' 'needs a terminal'
says '012#' 'aces send Reference board=2 position=[100,-40] -p hubo'
left_out 'aces play walk.blf -i socketcan -c can0 --tx' 'needs SocketCAN'
left_out 'aces bridge can0 unix:can0 --tx --filter 060:7F0' 'needs SocketCAN'
left_out 'aces bus serve can0' 'does not end by itself'
aces bus serve can0 > serve.txt 2>&1 & # instead
SERVING=$!
for _ in $(seq 600); do grep -q can0 serve.txt && break || sleep 0.1; done
says 'can0' 'aces bus list'                              # instead
says 'sent=' 'aces send 123#00 -c can0 --tx'             # instead
says 'frames=' 'aces sniff can0 -p hubo --for 0.2s'      # instead
kill "$SERVING" && wait "$SERVING" || true
SERVING=""
says 'at twice the rate' 'aces bus budget hubo2plus'
says 'nothing found' 'aces device fuzz hubo_ft --twin --frames 2000'
left_out 'aces run -r hubo2plus examples/walk_controller.py --virtual' 'does not end by itself'
says 'seconds=2.000' 'aces run -r hubo2plus examples/walk_controller.py --virtual --for 2s' # instead
left_out 'aces run -r examples/minihubo_like_hubo.toml examples/walk_controller.py --virtual' 'does not end by itself'
says 'seconds=2.000' 'aces run -r examples/minihubo_like_hubo.toml examples/walk_controller.py --virtual --for 2s' # instead
left_out 'aces run -r hubo2plus examples/walk_controller.py --replay walk.blf' 'needs a recording of a whole walk'
says 'a damiao for each' 'aces robot import examples/arm.urdf -o arm.toml'
left_out 'aces run -r quadruped examples/quadruped_walk.py --virtual --physics mujoco' 'needs MuJoCo'
left_out 'aces run -r hubo2plus examples/walk_controller.py --virtual --ros2' 'needs cyclonedds'
left_out 'aces jog -r arm.toml --virtual' 'needs a terminal'

# ---------------------------------------------------------------------- the tutorial, and Python in six lines

pages() { pytest -q -p no:cacheprovider -c /dev/null --rootdir . --noconftest --import-mode=importlib "$@"; }
pages "$ROOT/tests/test_docs_console.py"
pages "$ROOT/tests/test_docs.py" -k 'examples_in_prose_run and docs/python.md'
echo "first hour: ok"
