"""The content of a pickle that holds nothing but plain things, found without unpickling.

An unpickler calls what a pickle names. Even one that admits numpy alone can be crashed, because numpy's constructors
believe the state that they are handed. So nothing is called here: the few instructions that pickles of numbers, texts,
lists, dictionaries and arrays of numbers consist of are carried out on plain Python values, what stands for numpy's
types and arrays records what the pickle says of it, and the bytes of numbers are decoded once type, shape and size
agree. Any other instruction, or name, is an error.
"""

from __future__ import annotations

import math
import pickletools
import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.visible import in_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MOST_BYTES = 1 << 20
"""Of a pickle; the published ones have 2 kB."""
_MOST_VALUES = 200_000
_DEEPEST = 32
_MOST_DIMENSIONS = 8
_NEWEST_PROTOCOL = 5
_LONGEST_NAME = 100  # that a message shows
_NUMBER_CHARACTERS = 64
_LONGEST_INTEGER = 9  # bytes: unsigned ones of 64 bits take a ninth

_TYPE_CODE = re.compile(r"b1|[iu][1248]|f[248]|O[48]?", re.ASCII)
_QUOTED = re.compile(rb"""(['"])(?:[^\\]|\\[\\'"nrt]|\\x[0-9a-f]{2})*\1""", re.DOTALL)


class PlainPickleError(ValueError):
    """A pickle holds, or asks for, something that is not plain; or it is damaged."""


@dataclass(frozen=True, slots=True)
class _Named:
    """A name that a pickle asks for, and that stands for itself: it is never imported."""

    name: str


@dataclass(slots=True)
class _Type:
    """A dtype, as a pickle describes it."""

    code: str
    order: str = "="

    @property
    def is_object(self) -> bool:
        return self.code.startswith("O")


@dataclass(slots=True)
class _Array:
    """An array, as a pickle describes it; it has no type before its state came.

    It is decoded where it is wanted: a pickle of a few bytes can describe the same megabyte many times over.
    """

    kind: _Type | None = None
    data: Any = None
    shape: tuple[Any, ...] = ()
    order: str = "C"


_ARRAY, _TYPE, _ENCODE = _Named("numpy.ndarray"), _Named("numpy.dtype"), _Named("_codecs.encode")
_RECONSTRUCT, _SCALAR, _FROM_BUFFER = _Named("_reconstruct"), _Named("scalar"), _Named("_frombuffer")
# How numpy 1 and 2, on Python 2 and 3, name what an array is made by.
_NAMES = {("numpy", "ndarray"): _ARRAY, ("numpy", "dtype"): _TYPE, ("_codecs", "encode"): _ENCODE} | {
    (f"numpy.{core}.{module}", named.name): named
    for core in ("core", "_core")
    for module, named in (("multiarray", _RECONSTRUCT), ("multiarray", _SCALAR), ("numeric", _FROM_BUFFER))
}


def plain_content(pickled: bytes) -> Any:
    """Return what a pickle holds: dictionaries with keys of text, lists, texts, numbers, booleans, ``None``.

    Arrays and tuples become lists, numpy's numbers those of Python; bytes and strings of Python 2 become text, as
    Latin-1.

    Raises
    ------
    PlainPickleError
        If it holds or asks for anything else, is damaged, larger than :data:`MOST_BYTES`, or nested too deeply.
    """
    if len(pickled) > MOST_BYTES:
        raise PlainPickleError(f"it has more than {MOST_BYTES} bytes")
    return _Plain().of(_Machine(pickled).result())


# --- instructions -------------------------------------------------------------------------------------------------


def _integer(data: bytes) -> int:
    if len(data) > _LONGEST_INTEGER:
        raise PlainPickleError("it holds an integer of more than 64 bits")
    return int.from_bytes(data, "little", signed=True)


def _utf8(data: bytes) -> str:
    return data.decode("utf-8", "surrogatepass")


def _latin1(data: bytes) -> str:
    return data.decode("latin1")


def _number(line: bytes, kind: Callable[[str], Any]) -> Any:
    if len(line) > _NUMBER_CHARACTERS:
        raise PlainPickleError(f"it holds a number of {len(line)} characters")
    return kind(line.decode("ascii"))


def _quoted(line: bytes) -> str:
    if not _QUOTED.fullmatch(line):
        raise PlainPickleError("it holds a string that is not quoted as Python 2 quotes it")
    return line[1:-1].decode("unicode_escape")


_CONSTANTS: dict[bytes, Any] = {b"N": None, b"\x88": True, b"\x89": False}
_NUMBERS = {code: struct.Struct(form) for code, form in ((b"J", "<i"), (b"K", "<B"), (b"M", "<H"), (b"G", ">d"))}
# The length, and what the bytes that follow it are.
_COUNTED: dict[bytes, tuple[struct.Struct, Callable[[bytes], Any]]] = {
    code: (struct.Struct(form), decode)
    for code, form, decode in (
        *((b"X", "<I", _utf8), (b"\x8c", "<B", _utf8), (b"\x8d", "<Q", _utf8)),
        *((b"B", "<I", bytes), (b"C", "<B", bytes), (b"\x8e", "<Q", bytes), (b"\x96", "<Q", bytes)),
        *((b"T", "<I", _latin1), (b"U", "<B", _latin1)),
        *((b"\x8a", "<B", _integer), (b"\x8b", "<I", _integer)),
    )
}
_LINES: dict[bytes, Callable[[bytes], Any]] = {
    b"I": lambda line: {b"00": False, b"01": True}[line] if line in (b"00", b"01") else _number(line, int),
    b"L": lambda line: _number(line.removesuffix(b"L"), int),
    b"F": lambda line: _number(line, float),
    b"S": _quoted,
    b"V": lambda line: line.decode("raw-unicode-escape"),
}
_INSTRUCTIONS = {known.code.encode("latin1"): known.name for known in pickletools.opcodes}
_SMALL_TUPLES = {b")": 0, b"\x85": 1, b"\x86": 2, b"\x87": 3}
_BYTE, _WORD = struct.Struct("<B"), struct.Struct("<I")


class _Machine:
    """The stack, the marks in it and the memo of a pickle; each instruction takes one byte or more, so it ends."""

    def __init__(self, pickled: bytes) -> None:
        self._pickled = pickled
        self._at = 0
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}

    def result(self) -> Any:
        """Carry the instructions out; return what is on top of the stack at the end."""
        while (code := self._take(1)) != b".":
            if not (self._value(code) or self._container(code) or self._memory(code) or self._object(code)):
                raise PlainPickleError(f"it has the instruction {_INSTRUCTIONS.get(code, code)}, which is not plain")
        return self._pop()

    # --- instructions, in groups; each returns whether the instruction is one of them

    def _value(self, code: bytes) -> bool:
        """Push a constant, a number, a text or bytes."""
        if code in _CONSTANTS:
            self._stack.append(_CONSTANTS[code])
        elif code in _NUMBERS:
            self._stack.append(self._unpack(_NUMBERS[code]))
        elif code in _COUNTED:
            length, decode = _COUNTED[code]
            self._stack.append(decode(self._take(self._unpack(length))))
        elif code in _LINES:
            self._stack.append(_LINES[code](self._line()))
        else:
            return False
        return True

    def _container(self, code: bytes) -> bool:
        """Make a tuple, list or dictionary, or add to one."""
        match code:
            case b"(":
                self._marks.append(len(self._stack))
            case b")" | b"\x85" | b"\x86" | b"\x87":
                self._stack.append(tuple(self._pops(_SMALL_TUPLES[code])))
            case b"t":
                self._stack.append(tuple(self._to_mark()))
            case b"]":
                self._stack.append([])
            case b"l":
                self._stack.append(self._to_mark())
            case b"a" | b"e":
                items = self._pops(1) if code == b"a" else self._to_mark()
                self._top(list).extend(items)
            case b"}":
                self._stack.append({})
            case b"d":
                self._stack.append(_entries(self._to_mark()))
            case b"s" | b"u":
                items = self._pops(2) if code == b"s" else self._to_mark()
                self._top(dict).update(_entries(items))
            case _:
                return False
        return True

    def _memory(self, code: bytes) -> bool:
        """Remember what is on top of the stack, or recall it; pass over what only helps a reader."""
        match code:
            case b"\x80":
                protocol = self._unpack(_BYTE)
                if protocol > _NEWEST_PROTOCOL:
                    raise PlainPickleError(f"it is of protocol {protocol}; known are 0 to {_NEWEST_PROTOCOL}")
            case b"\x95":
                self._take(8)  # how long a frame is
            case b"p" | b"q" | b"r" | b"\x94":
                # The memo is a dictionary: an index does not reserve what lies below it.
                self._memo[len(self._memo) if code == b"\x94" else self._index(code)] = self._top(object)
            case b"g" | b"h" | b"j":
                index = self._index(code)
                if index not in self._memo:
                    raise PlainPickleError("it recalls something that it has not remembered")
                self._stack.append(self._memo[index])
            case _:
                return False
        return True

    def _object(self, code: bytes) -> bool:
        """Ask for a name, make something by it, or say what that holds."""
        match code:
            case b"c":
                self._ask(_utf8(self._line()), _utf8(self._line()))
            case b"\x93":
                self._ask(*self._pops(2))
            case b"R":
                called, arguments = self._pops(2)
                if not isinstance(called, _Named) or type(arguments) is not tuple:
                    raise PlainPickleError("it calls something that is not a name")
                self._stack.append(_made(called, arguments))
            case b"b":
                state = self._pop()
                _set_state(self._top(object), state)
            case _:
                return False
        return True

    def _ask(self, module: Any, name: Any) -> None:
        if not (isinstance(module, str) and isinstance(name, str)):
            raise PlainPickleError("it asks for a name that is not text")
        if (module, name) not in _NAMES:
            raise PlainPickleError(f"it asks for {in_line(f'{module}.{name}'[:_LONGEST_NAME])}")
        self._stack.append(_NAMES[module, name])

    # --- reading

    def _take(self, count: int) -> bytes:
        taken = self._pickled[self._at : self._at + count]
        if len(taken) < count:
            raise PlainPickleError(f"it ends {count - len(taken)} bytes too early")
        self._at += count
        return taken

    def _unpack(self, form: struct.Struct) -> Any:
        return form.unpack(self._take(form.size))[0]

    def _line(self) -> bytes:
        end = self._pickled.find(b"\n", self._at)
        if end < 0:
            raise PlainPickleError("it ends within a line")
        line = self._pickled[self._at : end]
        self._at = end + 1
        return line

    def _index(self, code: bytes) -> int:
        if code in b"pg":
            return int(_number(self._line(), int))
        return int(self._unpack(_BYTE if code in b"qh" else _WORD))

    # --- the stack

    def _pops(self, count: int) -> list[Any]:
        start = len(self._stack) - count
        if start < (self._marks[-1] if self._marks else 0):
            raise PlainPickleError("it takes more from its stack than there is")
        taken = self._stack[start:]
        del self._stack[start:]
        return taken

    def _pop(self) -> Any:
        return self._pops(1)[0]

    def _to_mark(self) -> list[Any]:
        if not self._marks:
            raise PlainPickleError("it goes back to a mark that it has not made")
        mark = self._marks.pop()
        taken = self._stack[mark:]
        del self._stack[mark:]
        return taken

    def _top(self, kind: type) -> Any:
        """Return what is on top of the stack, which must be a list, say, to be added to."""
        top = self._pop()
        self._stack.append(top)
        if not isinstance(top, kind):
            raise PlainPickleError(f"it adds to something that is not a {kind.__name__}")
        return top


def _entries(items: Sequence[Any]) -> dict[str, Any]:
    """Return neighbours as keys and values. Keys become text, which no file can choose the hashes of."""
    if len(items) % 2:
        raise PlainPickleError("it has a key without a value")
    if not all(isinstance(key, (str, bytes, int, float, type(None))) for key in items[::2]):
        raise PlainPickleError("it has a key that is neither text nor a number")
    return {str(key): value for key, value in zip(items[::2], items[1::2], strict=True)}


# --- arrays -------------------------------------------------------------------------------------------------------


def _made(called: _Named, arguments: tuple[Any, ...]) -> Any:
    """Return what a call stands for; nothing is called."""
    match called, arguments:
        case _Named("_codecs.encode"), (str() as text, str() as encoding):  # how older pickles hold bytes
            if encoding != "latin1":
                raise PlainPickleError(f"it asks for the encoding {in_line(encoding[:_LONGEST_NAME])}")
            return text  # taken as Latin-1 where bytes are wanted
        case _Named("numpy.dtype"), (str() as code, *_):
            if not _TYPE_CODE.fullmatch(code):
                raise PlainPickleError(f"it has values of type {in_line(code[:_LONGEST_NAME])}; only numbers are taken")
            return _Type(code)
        case _Named("_reconstruct"), (_Named("numpy.ndarray"), *_):
            return _Array()
        case _Named("scalar"), (_Type() as kind, bytes() | str() as data):
            return _numbers(kind, data, (), "C")
        case _Named("_frombuffer"), (bytes() as data, _Type() as kind, tuple() as shape, "C" | "F" as order):
            if kind.is_object:
                raise PlainPickleError("it takes bytes for Python objects")
            return _Array(kind, data, shape, order)
    raise PlainPickleError(f"it calls {called.name} with something else than numpy does")


def _set_state(target: Any, state: Any) -> None:
    match target, state:
        case _Type(), (_, "<" | ">" | "|" | "=" as order, None, None, None, *_):
            target.order = order
        case _Array(), (_, tuple() as shape, _Type() as kind, bool() | int() as fortran, data):
            target.kind, target.data, target.shape, target.order = kind, data, shape, "CF"[bool(fortran)]
        case _:
            raise PlainPickleError("it sets a state that is not that of an array or type of numpy")


def _sides(shape: tuple[Any, ...]) -> tuple[int, ...]:
    if len(shape) > _MOST_DIMENSIONS or not all(type(side) is int and side >= 0 for side in shape):
        raise PlainPickleError("it has an array of a shape that no array has")
    if math.prod(max(side, 1) for side in shape) > _MOST_VALUES:
        raise PlainPickleError(f"it has an array of more than {_MOST_VALUES} values")
    return shape


def _numbers(kind: _Type, data: Any, shape: tuple[Any, ...], order: str) -> Any:
    """Return bytes as numbers in nested lists, or as one number."""
    if kind.is_object:
        raise PlainPickleError("it takes bytes for Python objects")
    sides, dtype = _sides(shape), np.dtype(f"{kind.order}{kind.code}")
    content = data.encode("latin1") if isinstance(data, str) else data  # Python 2's bytes
    if not isinstance(content, bytes) or len(content) != math.prod(sides) * dtype.itemsize:
        raise PlainPickleError("it has an array whose bytes are not those of its shape and type")
    flat = np.frombuffer(content, dtype) if content else np.empty(0, dtype)
    return (flat.reshape(sides[::-1]).T if order == "F" else flat.reshape(sides)).tolist()


def _objects(data: Any, shape: tuple[Any, ...]) -> Any:
    """Return a list of anything as nested lists of a shape, the last index running fastest."""
    sides = _sides(shape)
    if type(data) is not list or len(data) != math.prod(sides):
        raise PlainPickleError("it has an array of objects that are not as many as its shape says")
    nested = data
    for side in sides[:0:-1]:
        nested = [nested[start : start + side] for start in range(0, len(nested), side)] if side else []
    return nested if sides else data[0]


# --- to plain types -----------------------------------------------------------------------------------------------


class _Plain:
    """Copies what a machine made as dictionaries, lists and single values, so many and no more."""

    def __init__(self) -> None:
        self._left = _MOST_VALUES

    def of(self, value: Any, depth: int = 0) -> Any:
        """Return a copy in plain types; what is shared is copied each time, and counts each time."""
        self._count(1)
        if depth > _DEEPEST:
            raise PlainPickleError(f"it is nested more than {_DEEPEST} deep, or holds itself")
        match value:
            case dict():
                return {key: self.of(item, depth + 1) for key, item in value.items()}
            case list() | tuple():
                return [self.of(item, depth + 1) for item in value]
            case bytes():
                return value.decode("latin1")
            case _Array(kind=_Type() as kind, data=data, shape=shape, order=order):
                if kind.is_object:
                    return self.of(_objects(data, shape), depth + 1)
                self._count(math.prod(max(side, 1) for side in _sides(shape)))
                return _numbers(kind, data, shape, order)
            case _Named() | _Type() | _Array():
                raise PlainPickleError("it holds a type, or an array without its values, where a value should be")
            case _:
                return value

    def _count(self, values: int) -> None:
        self._left -= values
        if self._left < 0:
            raise PlainPickleError(f"it holds more than {_MOST_VALUES} values")
