"""Importing published parameter files: dictionaries come through, code does not."""

from __future__ import annotations

import builtins
import dataclasses
import io
import os
import pickle
import subprocess
from collections import OrderedDict
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest

from eldata.errors import ProfileError
from eldata.noise import CameraProfile, profiles_from_published, read_published
from tests.cases import in_one_test

NESTED: dict[str, Any] = {
    "Kmin": np.float64(0.25),
    "Kmax": 16.0,
    "count": np.int32(3),
    "yes": np.bool_(True),
    "G_shape": np.array([0.1, 0.0, -0.2]),
    "color_bias": np.arange(12, dtype=np.float32).reshape(3, 4),
    "list": [1, 2.5, "text", None, (np.float32(0.5), [np.int64(7)])],
    "Profile-1": {"G_scale": {"slope": np.float64(0.5), "bias": -1.0, "sigma": np.array(0.25)}},
    "objects": np.array([1, "two", None], dtype=object),
    "big-endian": np.array([1.5, 2.5], dtype=">f8"),
}
PLAIN: dict[str, Any] = {
    "Kmin": 0.25,
    "Kmax": 16.0,
    "count": 3,
    "yes": True,
    "G_shape": [0.1, 0.0, -0.2],
    "color_bias": [[0.0, 1.0, 2.0, 3.0], [4.0, 5.0, 6.0, 7.0], [8.0, 9.0, 10.0, 11.0]],
    "list": [1, 2.5, "text", None, [0.5, [7]]],
    "Profile-1": {"G_scale": {"slope": 0.5, "bias": -1.0, "sigma": 0.25}},
    "objects": [1, "two", None],
    "big-endian": [1.5, 2.5],
}


def npy(payload: bytes, shape: tuple[int, ...] = (), descr: str = "|O", version: tuple[int, int] = (1, 0)) -> bytes:
    """A numpy file with any payload."""
    stream = io.BytesIO()
    header = {"descr": descr, "fortran_order": False, "shape": shape}
    write = np.lib.format.write_array_header_1_0 if version == (1, 0) else np.lib.format.write_array_header_2_0
    write(stream, header)
    return stream.getvalue() + payload


def held(content: object, protocol: int) -> bytes:
    """The pickle of a zero-dimensional object array that holds ``content``, as numpy's save writes it."""
    array = np.empty((), dtype=object)
    array[()] = content
    return pickle.dumps(array, protocol=protocol)


def file_of(folder: Path, data: bytes) -> Path:
    path = folder / "Camera_params.npy"
    path.write_bytes(data)
    return path


# --- what comes through ---------------------------------------------------------------------------------------------


def test_a_file_that_numpy_saved(tmp_path: Path) -> None:
    path = tmp_path / "Camera_params.npy"
    np.save(path, np.array(NESTED, dtype=object), allow_pickle=True)
    read = read_published(path)
    assert read == PLAIN
    assert read_published(str(path)) == PLAIN
    assert type(read["Kmin"]) is float
    assert type(read["count"]) is int
    assert type(read["yes"]) is bool
    assert all(type(value) is float for value in read["G_shape"])


@pytest.mark.parametrize("version", [(1, 0), (2, 0)])
@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
def test_every_protocol(protocol: int, version: tuple[int, int], tmp_path: Path) -> None:
    assert read_published(file_of(tmp_path, npy(held(NESTED, protocol), version=version))) == PLAIN


@pytest.mark.parametrize("protocol", [2, 3])
def test_a_file_of_numpy_1(protocol: int, tmp_path: Path) -> None:
    payload = held(NESTED, protocol)
    assert b"cnumpy._core.multiarray\n" in payload
    old = payload.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    assert read_published(file_of(tmp_path, npy(old))) == PLAIN


def test_strings_of_python_2(tmp_path: Path) -> None:
    payload = b"\x80\x02}q\x00(U\x04Kminq\x01G?\xd0\x00\x00\x00\x00\x00\x00U\x04nameU\x01\xe9u."
    assert read_published(file_of(tmp_path, npy(payload))) == {"Kmin": 0.25, "name": "é"}


# --- what does not --------------------------------------------------------------------------------------------------


class Call:
    """Its pickle calls a function when it is loaded."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return self.function, self.arguments


def attacks(marker: Path) -> dict[str, Any]:
    code = f"open({str(marker)!r}, 'w').close()"
    return {
        "os.system": Call(os.system, f"touch '{marker}'"),
        "eval": Call(builtins.eval, code),
        "exec": Call(builtins.exec, code),
        "open": Call(builtins.open, str(marker), "w"),
        "Popen": Call(subprocess.Popen, ["touch", str(marker)]),
        "mkdir": Call(os.mkdir, str(marker)),
        "getattr": Call(builtins.getattr, marker, "touch"),
        "numpy.save": Call(np.save, str(marker), [1]),
        "numpy.memmap": Call(np.memmap, str(marker), "uint8", "w+", 0, (1,)),
        "nested pickle": Call(pickle.loads, pickle.dumps(Call(builtins.eval, code))),
    }


NAMES = list(attacks(Path("marker")))


@in_one_test("protocol", [0, 2, 3, 4, 5])
@in_one_test("name", NAMES)
def test_code_is_refused_by_name_and_does_not_run(name: str, protocol: int, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    attack = attacks(marker)[name]
    for content in (attack, {"Kmin": attack}, {"Kmin": [np.float64(1), (attack,)]}, np.array([attack], dtype=object)):
        path = file_of(tmp_path, npy(held(content, protocol)))
        with pytest.raises(ProfileError, match=r"Camera_params\.npy: .*it asks for .*none of it was run"):
            read_published(path)
        assert not marker.exists()


def test_the_attacks_are_real(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    pickle.loads(held(attacks(marker)["eval"], 4))
    assert marker.exists()


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("os", "system"),
        ("posix", "system"),
        ("numpy", "load"),
        ("numpy", "fromfile"),
        ("numpy", "ndarray.tofile"),
        ("numpy", "dtype.__class__"),
        ("numpy.core.multiarray", "fromfile"),
        ("numpy._core.multiarray", "_reconstruct.__self__"),
        ("numpy._core.numeric", "fromfile"),
        ("builtins", "getattr"),
        ("copyreg", "_reconstructor"),
        ("_codecs", "decode"),
        ("_codecs", "lookup"),
        ("numpy._core.records", "fromfile"),
        ("numpy.lib.format", "open_memmap"),
    ],
)
def test_names_beyond_the_few_are_refused(module: str, name: str, tmp_path: Path) -> None:
    old = f"c{module}\n{name}\n.".encode()
    new = b"\x80\x04\x8c" + bytes([len(module)]) + module.encode() + b"\x8c" + bytes([len(name)]) + name.encode()
    for payload in (old, new + b"\x93."):
        with pytest.raises(ProfileError, match=r"it asks for") as caught:
            read_published(file_of(tmp_path, npy(payload)))
        assert f"{module}.{name}" in str(caught.value)


@pytest.mark.parametrize("core", ["core", "_core"])
def test_bytes_never_become_object_pointers(core: str, tmp_path: Path) -> None:
    """How protocol 5 holds an array; with the type object the bytes would be taken for addresses."""
    call = f"cnumpy.{core}.numeric\n_frombuffer\n".encode() + b"(C\x08AAAAAAAAcnumpy\ndtype\n"
    payload = b"\x80\x05}X\x04\x00\x00\x00Kmin" + call + b"X\x01\x00\x00\x00O\x85RK\x01\x85X\x01\x00\x00\x00CtRs."
    with pytest.raises(ProfileError, match=r"is not a published parameter file \(.*(OBJECT|object)"):
        read_published(file_of(tmp_path, npy(payload)))
    number = payload.replace(b"X\x01\x00\x00\x00O\x85", b"X\x02\x00\x00\x00u8\x85")
    assert read_published(file_of(tmp_path, npy(number))) == {"Kmin": [0x4141414141414141]}


def test_another_codec_is_refused(tmp_path: Path) -> None:
    payload = b"\x80\x02c_codecs\nencode\nX\x01\x00\x00\x00aX\x05\x00\x00\x00utf-8\x86R."
    with pytest.raises(ProfileError, match="it asks for the encoding utf-8"):
        read_published(file_of(tmp_path, npy(payload)))


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize(
    "value", [OrderedDict(a=1), Fraction(1, 2), PurePosixPath("a"), Call, 1j], ids=lambda value: type(value).__name__
)
def test_objects_of_other_classes_are_refused(value: object, protocol: int, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"it asks for"):
        read_published(file_of(tmp_path, npy(held({"Kmin": value}, protocol))))


GOOD = npy(held(PLAIN, 4))


@in_one_test("length", sorted({1, 5, 6, 8, 10, 60, *range(128, len(GOOD), 37), len(GOOD) - 1}))
def test_a_truncated_file(length: int, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"Camera_params\.npy: is not a published parameter file"):
        read_published(file_of(tmp_path, GOOD[:length]))


@pytest.mark.parametrize(
    "data",
    [
        b"hello, world, this is no numpy file",
        bytes(200),
        b"\x93NUMPY\x09\x00" + bytes(100),
        b"\x93NUMPY\x01\x00\x10\x00{'descr': open()",
        npy(b"garbage"),
        npy(b"\x80\x04P1\n."),
        npy(b"\x80\x04\x88Q."),
        npy(b"\x80\x63."),
        held(PLAIN, 4),
    ],
)
def test_garbage(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"Camera_params\.npy: is not a published parameter file"):
        read_published(file_of(tmp_path, data))


@pytest.mark.parametrize("array", [np.arange(12.0), np.array(1.5), np.zeros((2, 3), np.uint16), np.array("text")])
def test_plain_arrays(array: Any, tmp_path: Path) -> None:
    path = tmp_path / "Camera_params.npy"
    np.save(path, array, allow_pickle=False)
    with pytest.raises(ProfileError, match=r"Camera_params\.npy: expected a dictionary"):
        read_published(path)


@pytest.mark.parametrize(("content", "kind"), [([1, 2], "list"), (1.5, "float"), ("text", "str"), (None, "NoneType")])
def test_another_content_than_a_dictionary(content: Any, kind: str, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=rf"Camera_params\.npy: expected a dictionary, found {kind}"):
        read_published(file_of(tmp_path, npy(held(content, 4))))


def test_a_list_of_dictionaries(tmp_path: Path) -> None:
    path = tmp_path / "Camera_params.npy"
    np.save(path, np.array([PLAIN, PLAIN], dtype=object), allow_pickle=True)
    with pytest.raises(ProfileError, match="expected a dictionary"):
        read_published(path)


def test_a_content_that_holds_itself(tmp_path: Path) -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(ProfileError, match=r"Camera_params\.npy"):
        read_published(file_of(tmp_path, npy(held({"Kmin": endless}, 4))))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"none_params\.npy: cannot be read: No such file"):
        read_published(tmp_path / "none_params.npy")
    with pytest.raises(ProfileError, match=r"is a folder, not a file"):
        read_published(tmp_path)
    with pytest.raises(ProfileError, match=r"is empty \(0 bytes\)"):
        read_published(file_of(tmp_path, b""))


# --- profiles -------------------------------------------------------------------------------------------------------

ROWS = 5


def published(profiles: int = 1) -> dict[str, Any]:
    """A dictionary as the published files hold it."""
    fit = {"slope": 0.5, "bias": -0.25, "sigma": 0.125}
    return {
        "Kmin": 0.125,
        "Kmax": 8.0,
        "G_shape": [0.01 * i for i in range(ROWS)],
        "color_bias": [[i, -i, 2 * i, 0.5] for i in range(ROWS)],
    } | {
        f"Profile-{n}": {
            "G_scale": fit | {"slope": float(n)},
            "g_scale": fit | {"bias": float(n)},
            "R_scale": fit | {"sigma": float(n)},
        }
        for n in range(1, profiles + 1)
    }


def test_a_profile_of_each_calibration() -> None:
    first, second = profiles_from_published("Camera", published(2), source="a test")
    assert (first.camera, first.source) == ("Camera", "a test, Profile-1")
    assert (second.camera, second.source) == ("Camera", "a test, Profile-2")
    for number, profile in ((1, first), (2, second)):
        (mode,) = profile.gain_modes
        assert (mode.tukey_lambda_fit.slope, mode.tukey_lambda_fit.intercept) == (number, -0.25)
        assert (mode.gauss_fit.slope, mode.gauss_fit.intercept) == (0.5, number)
        assert (mode.row_fit.slope, mode.row_fit.sigma) == (0.5, number)
        assert profile.gain_range_dn_per_e == (0.125, 8.0)
        assert [row.tukey_lambda for row in profile.rows] == [0.01 * i for i in range(ROWS)]
        assert [row.colour_bias_dn for row in profile.rows] == [(i, -i, 2 * i, 0.5) for i in range(ROWS)]


def test_rows_run_two_an_iso_and_a_note_says_so() -> None:
    (profile,) = profiles_from_published("Camera", published())
    assert [row.iso for row in profile.rows] == [100, 100, 200, 200, 400]
    assert [row.gain_dn_per_e for row in profile.rows] == [0.125, 0.125, 0.25, 0.25, 0.5]
    assert profile.iso_range == (100, 6400)
    assert any("inferred" in note for note in profile.notes)


def test_the_imported_profile_is_what_is_loaded_again(tmp_path: Path) -> None:
    (profile,) = profiles_from_published("Camera", published())
    profile.save(tmp_path / "camera.json")
    assert CameraProfile.load(tmp_path / "camera.json") == profile


def test_a_shipped_camera_from_its_published_form(tmp_path: Path) -> None:
    shipped = CameraProfile.load("SonyA7S2")

    def fit(name: str) -> dict[str, float]:
        line = getattr(shipped, name)
        return {"slope": line.slope, "bias": line.intercept, "sigma": line.sigma}

    data = {
        "Kmin": shipped.gain_range_dn_per_e[0],
        "Kmax": shipped.gain_range_dn_per_e[1],
        "G_shape": np.array([row.tukey_lambda for row in shipped.rows]),
        "color_bias": np.array([row.colour_bias_dn for row in shipped.rows]),
        "Profile-1": {"G_scale": fit("tukey_lambda_fit"), "g_scale": fit("gauss_fit"), "R_scale": fit("row_fit")},
    }
    path = tmp_path / "SonyA7S2_params.npy"
    np.save(path, np.array(data, dtype=object), allow_pickle=True)
    # Its levels are from elsewhere, and the last note says so.
    published_alone = dataclasses.replace(shipped, black_level_dn=None, white_level_dn=None, notes=shipped.notes[:-1])
    assert profiles_from_published("SonyA7S2", read_published(path)) == (published_alone,)


def without(data: dict[str, Any], *keys: str) -> dict[str, Any]:
    inner = data
    for key in keys[:-1]:
        inner = inner[key]
    del inner[keys[-1]]
    return data


@pytest.mark.parametrize(
    "keys",
    [
        ("Kmin",),
        ("Kmax",),
        ("G_shape",),
        ("color_bias",),
        ("Profile-1",),
        ("Profile-1", "G_scale"),
        ("Profile-1", "g_scale"),
        ("Profile-1", "R_scale"),
        ("Profile-1", "R_scale", "slope"),
        ("Profile-1", "g_scale", "bias"),
        ("Profile-1", "G_scale", "sigma"),
    ],
    ids="/".join,
)
def test_what_is_missing_is_named(keys: tuple[str, ...]) -> None:
    with pytest.raises(ProfileError, match=rf"^Camera: .*{keys[-1]}"):
        profiles_from_published("Camera", without(published(), *keys))


@pytest.mark.parametrize(
    "change",
    [
        {"Kmin": "much"},
        {"Kmax": None},
        {"Kmin": [1, 2]},
        {"G_shape": 0.1},
        {"G_shape": ["a"] * ROWS},
        {"G_shape": [0.1]},
        {"G_shape": [], "color_bias": []},
        {"color_bias": [0.1] * ROWS},
        {"color_bias": [[1, 2, 3]] * ROWS},
        {"color_bias": None},
        {"Profile-1": None},
        {"Profile-1": [1, 2]},
        {"Profile-1": {"G_scale": 1.0}},
        {"Profile-1": {"G_scale": {"slope": "steep", "bias": 0, "sigma": 0}}},
    ],
    ids=str,
)
def test_another_kind_of_value(change: dict[str, Any]) -> None:
    with pytest.raises(ProfileError, match=r"^Camera: "):
        profiles_from_published("Camera", published() | change)


def test_no_content_at_all() -> None:
    with pytest.raises(ProfileError, match="Kmin"):
        profiles_from_published("Camera", {})
