"""Parameter files made to crash, stall or fill the memory of whoever unpickles them, by what each tries.

Run as a program it reads each of them in a process whose memory is limited, and prints what became of it.
"""

from __future__ import annotations

import io
import json
import pickle
import resource
import struct
import sys
from pathlib import Path

import numpy as np

from tests.peak import peak_kib

MEMORY_BYTES = 1 << 30
"""More than the libraries take at the start, and less than any of these would like."""

RECONSTRUCT = b"cnumpy.core.multiarray\n_reconstruct\n"
SCALAR = b"cnumpy.core.multiarray\nscalar\n"
FROM_BUFFER = b"cnumpy.core.numeric\n_frombuffer\n"
NDARRAY = b"cnumpy\nndarray\n"
DTYPE = b"cnumpy\ndtype\n"
EMPTY = RECONSTRUCT + NDARRAY + b"K\x00\x85C\x01b\x87R"


def text(content: str) -> bytes:
    return b"X" + struct.pack("<I", len(content)) + content.encode()


def kind(code: str, state: bytes = b"") -> bytes:
    """A dtype; ``state`` is what stands for the tuple that it is built from."""
    return DTYPE + text(code) + b"K\x00K\x01\x87R" + (state + b"b" if state else b"")


def integer(value: int) -> bytes:
    packed = value.to_bytes(9, "little", signed=True)
    return b"\x8a\x09" + packed


def array(shape: bytes, of: bytes, data: bytes, version: bytes = b"K\x01", fortran: bytes = b"\x89") -> bytes:
    return EMPTY + b"(" + version + shape + of + fortran + data + b"tb"


def usual(order: str = "<", *rest: bytes) -> bytes:
    """The state of a dtype, as numpy writes it."""
    return b"(K\x03" + text(order) + b"".join(rest or (b"NNN", b"J\xff\xff\xff\xff" * 2, b"K\x00")) + b"t"


FLOATS = kind("f8", usual())
OBJECTS = kind("O", usual("|", b"NNN", b"J\xff\xff\xff\xff" * 2, b"K?"))
EIGHT = b"C\x08AAAAAAAA"


def in_dictionary(content: bytes) -> bytes:
    return b"\x80\x04}" + text("Kmin") + content + b"s."


def made_before(content: bytes, use: bytes = b"h\x00") -> bytes:
    """A dictionary of what is made, and remembered, before it."""
    return b"\x80\x04" + content + b"}" + text("Kmin") + use + b"s."


def doubled(start: bytes, step: bytes, times: int) -> bytes:
    """Each step holds what came before twice."""
    return start + b"q\x00" + (step + b"q\x00") * times


CRAFTED: dict[str, bytes] = {
    # States that numpy's own classes believe.
    "dtype-size-of-gigabytes": in_dictionary(
        array(b"K\x01\x85", kind("V8", usual("|", b"NNN", b"J\xff\xff\xff\x7fK\x01K\x00")), EIGHT)
    ),
    "dtype-negative-size": in_dictionary(
        array(b"K\x01\x85", kind("V8", usual("|", b"NNN", b"J\x00\x00\x00\x80K\x01K\x00")), EIGHT)
    ),
    "dtype-alignment": in_dictionary(
        array(b"K\x01\x85", kind("V8", usual("|", b"NNN", b"K\x08J\xff\xff\xff\x7fK\x00")), EIGHT)
    ),
    "dtype-flags-without-objects": in_dictionary(
        array(b"K\x01\x85", kind("V8", usual("|", b"NNN", b"K\x08K\x01K?")), EIGHT)
    ),
    "dtype-object-of-no-flags": in_dictionary(
        array(b"K\x01\x85", kind("O", usual("|", b"NNN", b"J\xff\xff\xff\xff" * 2, b"K\x00")), EIGHT)
    ),
    "dtype-fields-beyond-its-size": in_dictionary(
        array(
            b"K\x01\x85",
            kind(
                "V8",
                b"(K\x03"
                + text("|")
                + b"N"
                + text("a")
                + b"\x85}"
                + text("a")
                + FLOATS
                + b"J\xff\xff\xff\x7f\x86sK\x08K\x01K\x00t",
            ),
            EIGHT,
        )
    ),
    "dtype-field-of-objects": in_dictionary(
        array(
            b"K\x01\x85",
            kind(
                "V8",
                b"(K\x03"
                + text("|")
                + b"N"
                + text("a")
                + b"\x85}"
                + text("a")
                + OBJECTS
                + b"K\x00\x86sK\x08K\x01K\x00t",
            ),
            EIGHT,
        )
    ),
    "dtype-names-of-numbers": in_dictionary(kind("V8", b"(K\x03" + text("|") + b"NK\x05\x85}K\x08K\x01K\x00t")),
    "dtype-subarray-of-endless-shape": in_dictionary(
        array(
            b"K\x01\x85",
            kind("V8", b"(K\x03" + text("|") + FLOATS + integer(2**62) + b"\x85\x86NNK\x08K\x01K\x00t"),
            EIGHT,
        )
    ),
    "dtype-of-itself": in_dictionary(
        DTYPE + text("V8") + b"K\x00K\x01\x87Rq\x07(K\x03" + text("|") + b"h\x07K\x02\x85\x86NNK\x08K\x01K\x00tb"
    ),
    "dtype-with-a-metadata-of-dates": in_dictionary(
        kind(
            "M8",
            b"(K\x04" + text("<") + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00}C\x02ns(K\x00K\x00K\x00K\x00t\x86t",
        )
    ),
    "dtype-state-of-one": in_dictionary(kind("f8", b"K\x03\x85")),
    "dtype-state-is-not-a-tuple": in_dictionary(kind("f8", b"]")),
    "dtype-called-with-a-list": in_dictionary(DTYPE + b"]\x85R"),
    "dtype-of-a-long-text": in_dictionary(DTYPE + text("f4," * 30_000) + b"\x85R"),
    "dtype-text-of-gigabytes": in_dictionary(array(b"K\x01\x85", kind("U500000000", usual()), EIGHT)),
    # Arrays whose shape and bytes do not agree.
    "array-huge-with-few-bytes": in_dictionary(array(integer(2**62) + b"\x85", FLOATS, EIGHT)),
    "array-product-overflows": in_dictionary(array(integer(2**33) + integer(2**33) + b"\x86", FLOATS, EIGHT)),
    "array-negative-side": in_dictionary(array(integer(-1) + b"\x85", FLOATS, EIGHT)),
    "array-two-negative-sides": in_dictionary(array(integer(-1) + integer(-1) + b"\x86", FLOATS, EIGHT)),
    "array-of-nothing-with-endless-sides": in_dictionary(array(integer(2**40) + b"K\x00\x86", FLOATS, b"C\x00")),
    "array-of-1000-dimensions": in_dictionary(array(b"(" + b"K\x01" * 1000 + b"t", FLOATS, EIGHT)),
    "array-side-is-a-float": in_dictionary(array(b"G?\xf0\x00\x00\x00\x00\x00\x00\x85", FLOATS, EIGHT)),
    "array-state-before-it-has-one": in_dictionary(EMPTY),
    "array-without-data": in_dictionary(array(b"K\x01\x85", FLOATS, b"N")),
    "array-data-are-a-list": in_dictionary(array(b"K\x02\x85", FLOATS, b"]")),
    "array-objects-from-bytes": in_dictionary(array(b"K\x01\x85", OBJECTS, EIGHT)),
    "array-objects-too-few": in_dictionary(array(b"K\x05\x85", OBJECTS, b"]K\x01a")),
    "array-objects-endless": in_dictionary(array(integer(2**40) + b"\x85", OBJECTS, b"]")),
    "array-state-of-another-version": in_dictionary(array(b"K\x01\x85", FLOATS, EIGHT, version=integer(2**60))),
    "array-in-its-own-state": in_dictionary(EMPTY + b"q\x05(K\x01)" + OBJECTS + b"\x89]h\x05atb"),
    "array-state-twice": in_dictionary(
        array(b"K\x01\x85", FLOATS, EIGHT) + b"(K\x01" + integer(2**50) + b"\x85" + FLOATS + b"\x89C\x00tb"
    ),
    "array-type-is-a-text": in_dictionary(array(b"K\x01\x85", text("f8"), EIGHT)),
    "array-of-another-class": in_dictionary(RECONSTRUCT + DTYPE + b"K\x00\x85C\x01b\x87R"),
    "array-reconstructed-at-an-endless-shape": in_dictionary(
        RECONSTRUCT + NDARRAY + integer(2**40) + b"\x85C\x01d\x87R"
    ),
    "array-class-called": in_dictionary(NDARRAY + integer(2**40) + b"\x85\x85R"),
    "array-class-called-with-strides": in_dictionary(
        NDARRAY + b"(K\x05\x85" + text("O") + EIGHT + b"K\x00" + integer(1 << 40) + b"\x85tR"
    ),
    "the-same-values-many-times": made_before(
        b"B" + struct.pack("<I", 190_000) + bytes(190_000) + b"q\x00" + kind("b1", usual("|")) + b"q\x01",
        b"]" + array(integer(190_000) + b"\x85", b"h\x01", b"h\x00") + b"q\x02a" + b"h\x02a" * 90_000,
    ),
    "as-many-arrays-of-the-same-values": made_before(
        b"B" + struct.pack("<I", 190_000) + bytes(190_000) + b"q\x00" + kind("b1", usual("|")) + b"q\x01",
        b"]" + (array(integer(190_000) + b"\x85", b"h\x01", b"h\x00") + b"a") * 8000,
    ),
    "the-same-text-encoded-many-times": made_before(
        text("a" * 400_000) + text("latin1") + b"\x86q\x00c_codecs\nencode\nq\x01", b"]" + b"h\x01h\x00Ra" * 80_000
    ),
    "scalar-of-objects": in_dictionary(SCALAR + OBJECTS + EIGHT + b"\x86R"),
    "scalar-of-too-few-bytes": in_dictionary(SCALAR + FLOATS + b"C\x01A\x86R"),
    "scalar-of-nothing": in_dictionary(SCALAR + FLOATS + b"\x85R"),
    "scalar-of-a-text-type": in_dictionary(SCALAR + kind("U100000000", usual()) + EIGHT + b"\x86R"),
    "scalar-of-no-type": in_dictionary(SCALAR + b"NC\x08AAAAAAAA\x86R"),
    "buffer-of-objects": in_dictionary(FROM_BUFFER + b"(" + EIGHT + OBJECTS + b"K\x01\x85" + text("C") + b"tR"),
    "buffer-of-endless-shape": in_dictionary(
        FROM_BUFFER + b"(" + EIGHT + FLOATS + integer(2**61) + b"\x85" + text("C") + b"tR"
    ),
    "buffer-of-an-odd-order": in_dictionary(FROM_BUFFER + b"(" + EIGHT + FLOATS + b"K\x01\x85" + text("K") + b"tR"),
    # Instructions that reserve, repeat or recurse.
    "memo-index-of-gigabytes": in_dictionary(b"Kxr\xff\xff\xff\x7f"),
    "memo-index-negative": in_dictionary(b"Kxp-1\n"),
    "memo-index-of-many-digits": in_dictionary(b"Kxp" + b"9" * 5000 + b"\n"),
    "bytes-of-gigabytes": in_dictionary(b"\x8e" + struct.pack("<Q", 1 << 40) + b"A"),
    "bytearray-of-gigabytes": in_dictionary(b"\x96" + struct.pack("<Q", 3 << 30) + b"A"),
    "text-of-gigabytes": in_dictionary(b"\x8d" + struct.pack("<Q", 1 << 62) + b"A"),
    "string-of-negative-length": in_dictionary(b"T\xff\xff\xff\xffA"),
    "integer-of-gigabytes": in_dictionary(b"\x8b\xff\xff\xff\x7fA"),
    "integer-of-a-million-digits": in_dictionary(b"L" + b"9" * 900_000 + b"L\n"),
    "integer-of-many-bytes": in_dictionary(b"\x8b" + struct.pack("<I", 900_000) + b"\x7f" * 900_000),
    "number-of-a-million-characters": in_dictionary(b"F" + b"1" * 900_000 + b"\n"),
    "frame-of-gigabytes": b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + in_dictionary(b"K\x01")[2:],
    "lists-doubled": made_before(doubled(b"]", b"]h\x00ah\x00a", 60)),
    "tuples-doubled": made_before(doubled(b")", b"h\x00\x86", 60)),
    "tuples-doubled-as-a-key": b"\x80\x04}" + doubled(b")", b"h\x00\x86", 60) + b"K\x01s.",
    "dictionaries-doubled": made_before(doubled(b"}", b"}" + text("a") + b"h\x00s" + text("b") + b"h\x00s", 40)),
    "list-of-itself": in_dictionary(b"]q\x00h\x00a"),
    "dictionary-of-itself": b"\x80\x04}q\x00" + text("Kmin") + b"h\x00s.",
    "tuple-of-itself": in_dictionary(b"]q\x00h\x00\x85a"),
    "lists-100000-deep": in_dictionary(b"]" * 100_000 + b"a" * 99_999),
    "tuples-100000-deep": in_dictionary(b")" + b"\x85" * 100_000),
    "marks-without-an-end": b"\x80\x04" + b"(" * 900_000,
    "keys-of-one-hash": b"\x80\x04}("
    + b"".join(b"\x8a\x09" + (number * (2**61 - 1)).to_bytes(9, "little") + b"N" for number in range(1, 60))
    + b"u.",
    "key-is-a-list": b"\x80\x04}]K\x01s.",
    "key-without-a-value": b"\x80\x04}(K\x01u.",
    "pops-beyond-a-mark": b"\x80\x04}K\x01(\x86.",
    "takes-from-an-empty-stack": b"\x80\x04\x87\x87\x87.",
    "builds-nothing": b"\x80\x04b.",
    "appends-to-a-number": in_dictionary(b"K\x01K\x02a"),
    "sets-the-state-of-a-dictionary": in_dictionary(b"}}b"),
    "stops-with-nothing": b"\x80\x04.",
    "never-stops": in_dictionary(b"K\x01")[:-1],
    # Instructions that import, call or fetch.
    "instance": in_dictionary(b"(ios\nsystem\n"),
    "object": in_dictionary(b"(" + DTYPE + text("f8") + b"o"),
    "new-object": in_dictionary(NDARRAY + integer(2**40) + b"\x85\x81"),
    "new-object-with-keywords": in_dictionary(NDARRAY + b")}\x92"),
    "extension": in_dictionary(b"\x82\x01"),
    "persistent": in_dictionary(b"Pid\n"),
    "persistent-from-the-stack": in_dictionary(b"K\x01Q"),
    "next-buffer": in_dictionary(b"\x97"),
    "read-only-buffer": in_dictionary(b"C\x01A\x98"),
    "sets": in_dictionary(b"\x8f(K\x01\x90"),
    "frozen-set": in_dictionary(b"(K\x01\x91"),
    "name-with-an-escape": in_dictionary(b"c\x1b]0;x\x07\nsystem\n"),
    "name-of-numbers": in_dictionary(b"K\x01K\x02\x93"),
    "call-of-a-number": in_dictionary(b"K\x01)R"),
    "call-with-a-list": in_dictionary(DTYPE + b"]R"),
    "encode-as-something-else": in_dictionary(b"c_codecs\nencode\n" + text("a") + text("zlib") + b"\x86R"),
    "protocol-of-tomorrow": b"\x80\x63}.",
}


def file_of(pickled: bytes) -> bytes:
    """A .npy file of one object, as numpy saves it, whose pickle this is."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": ()})
    return stream.getvalue() + pickled


def good_file(protocol: int) -> bytes:
    """A file like the published ones."""
    fit = {"slope": np.float64(0.5), "bias": np.float64(-0.25), "sigma": 0.125}
    content = {
        "Kmin": np.float64(0.125),
        "Kmax": 8.0,
        "G_shape": np.linspace(-0.1, 0.1, 14),
        "color_bias": np.arange(56.0).reshape(14, 4),
        "Profile-1": {"G_scale": fit, "g_scale": dict(fit), "R_scale": dict(fit)},
    }
    held = np.empty((), dtype=object)
    held[()] = content
    return file_of(pickle.dumps(held, protocol=protocol))


def main(folder: Path) -> None:
    """Read the file of each crafted pickle; print the kind of error that it ended in, or what was read, as JSON."""
    from eldata.noise import read_published

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    outcomes = {}
    for path in sorted(folder.glob("*.npy")):
        try:
            outcomes[path.stem] = f"read {sorted(read_published(path))}"
        except Exception as error:  # noqa: BLE001 # whatever it is, it is what this program looks for
            outcomes[path.stem] = f"{type(error).__name__}: {error}"
    print(json.dumps({"outcomes": outcomes, "peak_kib": peak_kib()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
