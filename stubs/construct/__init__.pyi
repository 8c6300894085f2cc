"""Types of what this project uses of construct 2.10, which has none. The rest is Any, as without this file.

1. What is parsed, and what expressions such as `this.n` give, hangs on a struct that no checker can follow: that stays Any.
2. A stream is what construct reads and seeks: `io.BytesIO` in every use.
"""

from collections.abc import Callable
from collections.abc import Mapping as MappingOf
from typing import Any, BinaryIO

from . import core as core

def __getattr__(name: str) -> Any: ...

class ConstructError(Exception):
    path: str | None
    def __init__(self, message: str = "", path: str | None = None) -> None: ...

class SizeofError(ConstructError): ...
class StreamError(ConstructError): ...
class FormatFieldError(ConstructError): ...
class IntegerError(ConstructError): ...
class StringError(ConstructError): ...
class MappingError(ConstructError): ...
class RangeError(ConstructError): ...
class RepeatError(ConstructError): ...
class ConstError(ConstructError): ...
class CheckError(ConstructError): ...
class ExplicitError(ConstructError): ...
class ValidationError(ConstructError): ...
class TerminatedError(ConstructError): ...
class PaddingError(ConstructError): ...

class Container(dict[str, Any]):
    def __getattr__(self, name: str) -> Any: ...
    def __setattr__(self, name: str, value: Any) -> None: ...

class ListContainer(list[Any]): ...

class Construct:
    #: None where it has none; the fields of a struct have one.
    name: Any
    #: Of those that wrap another one: asked for by their class, mostly a set of classes, which no checker follows.
    subcon: Any
    docs: str
    flagbuildnone: bool
    parsed: Callable[[Any, Container], None] | None
    def parse(self, data: bytes | bytearray | memoryview, **contextkw: Any) -> Any: ...
    def parse_stream(self, stream: BinaryIO, **contextkw: Any) -> Any: ...
    def build(self, obj: Any, **contextkw: Any) -> bytes: ...
    def build_stream(self, obj: Any, stream: BinaryIO, **contextkw: Any) -> Any: ...
    def sizeof(self, **contextkw: Any) -> int: ...
    def _parse(self, stream: BinaryIO, context: Container, path: str) -> Any: ...
    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any: ...
    def _sizeof(self, context: Container, path: str) -> int: ...
    def _parsereport(self, stream: BinaryIO, context: Container, path: str) -> Any: ...
    def __rtruediv__(self, name: str | None) -> Renamed: ...
    def __mul__(self, other: str | Callable[..., Any]) -> Renamed: ...
    def __rmul__(self, other: str | Callable[..., Any]) -> Renamed: ...
    def __getitem__(self, count: Any) -> Array: ...

class Subconstruct(Construct):
    def __init__(self, subcon: Construct) -> None: ...

class Adapter(Subconstruct):
    def _decode(self, obj: Any, context: Container, path: str) -> Any: ...
    def _encode(self, obj: Any, context: Container, path: str) -> Any: ...

class Renamed(Subconstruct):
    def __init__(
        self,
        subcon: Construct,
        newname: str | None = None,
        newdocs: str | None = None,
        newparsed: Callable[[Any, Container], None] | None = None,
    ) -> None: ...

class Struct(Construct):
    subcons: list[Construct]
    def __init__(self, *subcons: Construct, **subconskw: Construct) -> None: ...
    def compile(self, filename: str | None = None) -> Construct: ...

class Sequence(Construct):
    subcons: list[Construct]
    def __init__(self, *subcons: Construct, **subconskw: Construct) -> None: ...

class FocusedSeq(Construct):
    subcons: list[Construct]
    parsebuildfrom: str
    def __init__(self, parsebuildfrom: str, *subcons: Construct, **subconskw: Construct) -> None: ...

class Array(Subconstruct):
    count: Any
    discard: bool
    def __init__(self, count: Any, subcon: Construct, discard: bool = False) -> None: ...

class GreedyRange(Subconstruct):
    discard: bool
    def __init__(self, subcon: Construct, discard: bool = False) -> None: ...

class FormatField(Construct):
    fmtstr: str
    length: int
    def __init__(self, endianity: str, format: str) -> None: ...

class BytesInteger(Construct):
    length: Any
    signed: bool
    swapped: Any
    def __init__(self, length: Any, signed: bool = False, swapped: Any = False) -> None: ...

class Bytes(Construct):
    length: Any
    def __init__(self, length: Any) -> None: ...

class Const(Subconstruct):
    value: Any
    def __init__(self, value: Any, subcon: Construct | None = None) -> None: ...

class Default(Subconstruct):
    value: Any
    def __init__(self, subcon: Construct, value: Any) -> None: ...

class Rebuild(Subconstruct):
    func: Any
    def __init__(self, subcon: Construct, func: Any) -> None: ...

class Prefixed(Subconstruct):
    lengthfield: Construct
    includelength: bool | None
    def __init__(
        self, lengthfield: Construct, subcon: Construct, includelength: bool | None = False
    ) -> None: ...

class FixedSized(Subconstruct):
    length: Any
    def __init__(self, length: Any, subcon: Construct) -> None: ...

class NullTerminated(Subconstruct):
    term: bytes
    include: bool
    consume: bool
    require: bool
    def __init__(
        self,
        subcon: Construct,
        term: bytes = b"\0",
        include: bool = False,
        consume: bool = True,
        require: bool = True,
    ) -> None: ...

class NullStripped(Subconstruct):
    pad: bytes
    def __init__(self, subcon: Construct, pad: bytes = b"\0") -> None: ...

class StringEncoded(Adapter):
    encoding: str
    def __init__(self, subcon: Construct, encoding: str) -> None: ...

class Transformed(Subconstruct):
    decodefunc: Callable[[bytes], bytes]
    decodeamount: int | None
    encodefunc: Callable[[bytes], bytes]
    encodeamount: int | None
    def __init__(
        self,
        subcon: Construct,
        decodefunc: Callable[[bytes], bytes],
        decodeamount: int | None,
        encodefunc: Callable[[bytes], bytes],
        encodeamount: int | None,
    ) -> None: ...

class Switch(Construct):
    keyfunc: Any
    cases: MappingOf[Any, Construct]
    default: Construct
    def __init__(
        self, keyfunc: Any, cases: MappingOf[Any, Construct], default: Construct | None = None
    ) -> None: ...

class IfThenElse(Construct):
    condfunc: Any
    thensubcon: Construct
    elsesubcon: Construct
    def __init__(self, condfunc: Any, thensubcon: Construct, elsesubcon: Construct) -> None: ...

def If(condfunc: Any, subcon: Construct) -> IfThenElse: ...
def stream_read(stream: BinaryIO, length: int, path: str) -> bytes: ...
def stream_read_entire(stream: BinaryIO, path: str) -> bytes: ...
def stream_write(stream: BinaryIO, data: bytes, length: int, path: str) -> None: ...

Byte: FormatField
Int8ub: FormatField
Int16ub: FormatField
Int32ub: FormatField
Int64ub: FormatField
Int8sb: FormatField
Int16sb: FormatField
Int32sb: FormatField
Int64sb: FormatField
Int8ul: FormatField
Int16ul: FormatField
Int32ul: FormatField
Int64ul: FormatField
Int8sl: FormatField
Int16sl: FormatField
Int32sl: FormatField
Int64sl: FormatField
Int24ul: BytesInteger
Int24ub: BytesInteger
Int24sl: BytesInteger
Int24sb: BytesInteger
Float16b: FormatField
Float16l: FormatField
Float32b: FormatField
Float32l: FormatField
Float64b: FormatField
Float64l: FormatField
GreedyBytes: Construct
VarInt: Construct
ZigZag: Construct
Pass: Construct
Terminated: Construct
