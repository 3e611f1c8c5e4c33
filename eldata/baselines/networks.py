"""Networks from files, as denoisers: TorchScript, torch.export, ONNX, or Python code of one's own.

A model is code, and the user's own. Weights are data: they come by ``torch.load(weights_only=True)`` or safetensors.
"""

from __future__ import annotations

import glob
import hashlib
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.base.fields import named_object
from eldata.base.files import sha256_of
from eldata.baselines.exported import TakenInput, checked_window, first_line, load_exported
from eldata.baselines.prediction_folder import ANSWERS, probe_network
from eldata.baselines.tiling import tiled
from eldata.errors import ArgumentError, EldataError, FileError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from numpy.typing import NDArray

    from eldata.baselines.noisy_frames import NoisyFrame
    from eldata.raw.levels import Clip

    Values = NDArray[np.floating[Any]]

Precision = Literal["float32", "bfloat16", "float16"]
_SIDE = 64  # of the fixed input: whole halvings and windows of attention fit


@dataclass(frozen=True, slots=True, eq=False)
class NetworkDenoiser:
    """A network over frames, in tiles.

    Attributes
    ----------
    run
        (C, h, w) float32 to (C, h, w); with a window of T > 1 frames, (T, C, h, w) to (C, h, w).
    identity
        What names the network: its file and hash, or its place in a module.
    tile, overlap, multiple
        As :func:`eldata.baselines.tiling.tiled` has them.
    precision
        What it computes in, part of the settings.
    window
        Frames of a clip that it takes, of which it predicts the middle one; 1: it takes single frames.
    clip
        Of the inputs that it was trained with, if that is known.
    is_code
        Whether it is code that the identity does not hold: then what it gives for a fixed input is part of it.
    """

    run: Callable[[NDArray[np.float32]], Values]
    identity: dict[str, str]
    tile: int = 1024
    overlap: int = 128
    multiple: int = 16
    precision: Precision = "float32"
    window: int = 1
    clip: Clip | None = None
    is_code: bool = False

    def settings(self, cameras: Collection[str], channels: Collection[int]) -> dict[str, Any]:  # noqa: ARG002 # any
        """Return the settings that decide its predictions."""
        known: dict[str, Any] = {} if self.clip is None else {"clip": self.clip}
        if self.is_code:
            frames, side = (self.window,) if self.window > 1 else (), self.multiple * -(-_SIDE // self.multiple)
            shapes = {count: (*frames, count, side, side) for count in channels}
            known[ANSWERS] = {
                str(count): probe_network(self.run, shape, self.precision) for count, shape in shapes.items()
            }
        options = {name: getattr(self, name) for name in ("tile", "overlap", "multiple", "precision", "window")}
        return {**self.identity, **options, **known}

    def __call__(self, frame: NoisyFrame) -> Values:
        """Return the network's prediction of a frame."""
        sides = {"tile": self.tile, "overlap": self.overlap, "multiple": self.multiple}
        image = frame.image if self.window == 1 else frame.window(self.window)
        *taken, height, width = image.shape  # tiles are cut of frames as of channels
        return tiled(
            lambda part: self.run(part.reshape(*taken, *part.shape[1:])), image.reshape(-1, height, width), **sides
        )


def _run_torch(function: Callable[..., Any], device: str, precision: Precision, image: NDArray[np.float32]) -> Values:
    """Run a module or function of tensors (1, C, h, w) or (1, T, C, h, w), on a device."""
    import torch

    numbers = torch.from_numpy(image)[None].to(device)
    mixed = None if precision == "float32" else getattr(torch, precision)
    try:
        with torch.inference_mode(), torch.autocast(numbers.device.type, dtype=mixed, enabled=mixed is not None):
            made = function(numbers)
    except Exception as error:
        advice = "; take smaller tiles (--tile)" if isinstance(error, torch.OutOfMemoryError) else ""
        raise EldataError(_describe_failure(image, error) + advice) from error
    return _take_image(made.float().cpu().numpy() if isinstance(made, torch.Tensor) else made, image)


def _run_onnx(session: Any, image: NDArray[np.float32]) -> Values:
    """Run a session of ONNX Runtime."""
    try:
        made = session.run(None, {session.get_inputs()[0].name: image[None]})[0]
    except Exception as error:  # ONNX Runtime's own classes, without a common base
        raise EldataError(_describe_failure(image, error)) from error
    return _take_image(made, image)


def _take_image(made: Any, image: NDArray[np.float32]) -> Values:
    """Take the image out of a network's batch of one."""
    if not isinstance(made, np.ndarray) or made.ndim != 4 or len(made) != 1:
        shape = getattr(made, "shape", type(made).__name__)
        raise EldataError(f"the network is to make (1, C, h, w) of {(1, *image.shape)}; it made {shape}")
    return np.asarray(made[0])


def load_network(
    model: str, *,
    weights: Path | str | None = None, device: str = "auto", precision: Precision = "float32", tile: int = 1024,
    overlap: int = 128, multiple: int | None = None, window: int | None = None,
) -> NetworkDenoiser:  # fmt: skip
    """Load a network.

    Parameters
    ----------
    model
        A TorchScript file (``.pt``, ``.pth``, ``.ts``), one of ``torch.export`` (``.pt2``) or an ONNX file (``.onnx``);
        or ``package.module:name``: a ``torch.nn.Module``, a class or function that makes one without being given
        arguments, or a function of a tensor (1, C, h, w).
    weights
        A state dict for a module from Python: safetensors, or a checkpoint that torch loads with ``weights_only=True``.
    device
        ``cpu``, ``cuda``, or ``auto``: CUDA if there is a GPU.
    precision
        ``bfloat16`` and ``float16`` compute in mixed precision, by torch's autocast; ``float16`` needs a GPU.
    tile, overlap, multiple
        As :func:`eldata.baselines.tiling.tiled` has them, in packed pixels. ``None``: the multiple that the network
        states (a file of :func:`~eldata.baselines.exported.save_network`, an attribute ``multiple``), else 16.
    window
        Frames of a clip that it takes as (1, T, C, h, w), of which it predicts the middle one. ``None``: what the
        network states, as for the multiple, else 1: single frames (1, C, h, w).

    Raises
    ------
    FileError
        If a file cannot be read, or is not of its kind.
    ArgumentError
        If a name is unknown, the options do not go together, or the network states another window or multiple.
    """
    import torch

    where = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    try:
        kind = torch.device(where).type
    except RuntimeError as error:
        raise ArgumentError(f"--device {device}: torch knows no such device; give cpu, cuda, cuda:1 or auto") from error
    if kind == "cuda" and not torch.cuda.is_available():
        raise ArgumentError(f"--device {device}: torch sees no GPU here; leave it out to work on the CPU")
    if precision == "float16" and kind == "cpu":
        raise ArgumentError("--precision float16 needs a GPU; on a CPU take bfloat16 or float32")
    run: Callable[[NDArray[np.float32]], Values]
    taken, is_code = TakenInput(), ":" in model and not Path(model).exists()
    if is_code:
        module = _import_network(model, weights)
        identity = {"denoiser": model}
        run = partial(_run_torch, _prepare_module(module, where), where, precision)
        if isinstance(module, torch.nn.Module):
            identity["weights_sha256"] = _digest_of(module)
            taken = TakenInput(_read_attribute(module, "window"), _read_attribute(module, "multiple"))
    else:
        if weights is not None:
            raise ArgumentError(f"--weights goes with package.module:name; {model} holds its own")
        path = Path(model)
        if not path.is_file():
            problem = "is a folder" if path.is_dir() else "there is no such file"
            raise FileError(path, f"{problem}; give a model's file, or package.module:name")
        identity = {"denoiser": path.name, "denoiser_sha256": sha256_of(path)}
        if path.suffix == ".onnx":
            beside = sorted(path.parent.glob(f"{glob.escape(path.name)}[._]data"))  # where exporters put large weights
            identity |= {file.name: sha256_of(file) for file in beside}
            if precision != "float32":
                raise ArgumentError(f"--precision is torch's; {model} computes in the types that it was exported with")
            run = partial(_run_onnx, _open_onnx(path, where))
        else:
            module, taken = load_exported(path) if path.suffix == ".pt2" else (_load_script(path), taken)
            run = partial(_run_torch, _prepare_module(module, where), where, precision)
    frames, sides = _choose_sizes(model, taken, window, multiple)
    return NetworkDenoiser(run, identity, tile, overlap, sides, precision, frames, taken.clip, is_code)


def _digest_of(module: Any) -> str:
    """Return ``sha256:<hex>`` of a module's weights and buffers, wherever they came from."""
    import torch

    digest = hashlib.sha256()
    for name, value in module.state_dict().items():
        digest.update(f"{name} {getattr(value, 'dtype', '')} {tuple(getattr(value, 'shape', ()))}".encode())
        plain = value.detach().cpu().contiguous().reshape(-1) if isinstance(value, torch.Tensor) else None
        digest.update(repr(value).encode() if plain is None else plain.view(torch.uint8).numpy().tobytes())
    return f"sha256:{digest.hexdigest()}"


def _read_attribute(module: Any, name: str) -> int | None:
    """Read a positive whole number from a module's attribute, if it has one."""
    value = getattr(module, name, None)
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else None


def _choose_sizes(model: str, taken: TakenInput, window: int | None, multiple: int | None) -> tuple[int, int]:
    """Choose the window and the multiple; the caller's must not contradict the network's."""
    if taken.window is not None and window not in (None, taken.window):
        what, option = f"windows of {taken.window} frames", f"--window {window}"
    elif taken.multiple is not None and multiple is not None and multiple % taken.multiple:
        what, option = f"sides that are multiples of {taken.multiple}", f"--multiple {multiple}"
    else:
        return checked_window(window or taken.window or 1), multiple or taken.multiple or 16
    raise ArgumentError(f"{model} takes {what}, by its own account; found {option}: leave it out")


def _prepare_module(function: Any, device: str) -> Callable[..., Any]:
    """Move a torch module to the device, in evaluation mode; any other function stays as it is."""
    import torch

    if isinstance(function, torch.nn.Module):
        function = function.to(device)
        # What torch raises for a module of torch.export, which stays in the mode in which it was exported.
        with suppress(NotImplementedError):
            function.eval()  # torch's: batch statistics stand still
    return function  # type: ignore[no-any-return] # callable: checked by who loaded it


def _load_script(path: Path) -> Any:
    """Load a TorchScript file on the CPU."""
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of torch.jit as a whole; files of it are about
        try:
            return torch.jit.load(str(path), map_location="cpu")  # type: ignore[no-untyped-call]
        except RuntimeError as error:
            raise FileError(
                path,
                "is not TorchScript. If it is a checkpoint, give the code that it belongs to: "
                f"eldata predict package.module:Network --weights {path.name} ({first_line(error)})",
            ) from error


def _open_onnx(path: Path, device: str) -> Any:
    """Open an ONNX file with ONNX Runtime; the network must have one input."""
    try:
        import onnxruntime
    except ImportError as error:
        raise EldataError(f"{path}: ONNX Runtime is not installed: pip install 'eldata[onnx]'") from error
    wanted = [*(["CUDAExecutionProvider"] if device.startswith("cuda") else []), "CPUExecutionProvider"]
    missing = set(wanted) - set(onnxruntime.get_available_providers())
    if missing:
        raise ArgumentError(
            f"--device {device}: this ONNX Runtime lacks {', '.join(sorted(missing))}; install its GPU build"
        )
    try:
        session = onnxruntime.InferenceSession(str(path), providers=wanted)
    except Exception as error:  # ONNX Runtime's own classes, without a common base
        raise FileError(path, f"cannot be loaded by ONNX Runtime: {first_line(error)}") from error
    if len(session.get_inputs()) != 1:
        raise FileError(path, f"expected one input, found {len(session.get_inputs())}")
    return session


def _import_network(place: str, weights: Path | str | None) -> Any:
    """Import ``package.module:name``, a network or its maker, and load weights into it."""
    import torch

    target = named_object(place)
    made = target() if _is_maker(place, target) else target
    if not callable(made):
        raise ArgumentError(f"{place} is {type(made).__name__}, not a module or function of tensors")
    if weights is not None:
        if not isinstance(made, torch.nn.Module):
            raise ArgumentError(f"--weights goes with a torch.nn.Module; {place} is {type(made).__name__}")
        _load_weights(made, Path(weights))
    return made


def _is_maker(place: str, target: Any) -> bool:
    """Tell a maker of networks, a class or a function without arguments, from a function of images."""
    import torch

    if not callable(target) or isinstance(target, torch.nn.Module):
        return False
    try:
        parameters = signature(target).parameters.values()
    except ValueError:  # some functions that are not written in Python state none
        return isinstance(target, type)
    several = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    asked = [parameter for parameter in parameters if parameter.kind not in several]
    needed = [parameter.name for parameter in asked if parameter.default is Parameter.empty]
    if isinstance(target, type) and needed:
        raise ArgumentError(
            f"{place} is a class whose {', '.join(needed)} nobody gives here; give an instance, or a function without "
            "arguments that makes one"
        )
    # A function of *images takes them; one whose arguments all have defaults makes a network.
    return isinstance(target, type) or not (needed or any(parameter.kind is several[0] for parameter in parameters))


def _load_weights(module: Any, path: Path) -> None:
    """Load a file of weights (safetensors, or a checkpoint of torch) into a module."""
    import torch
    from safetensors.torch import load_file

    state: Any
    try:
        if path.suffix == ".safetensors":
            state = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise FileError(path, "there is no such file") from None
    except Exception as error:
        raise FileError(
            path, f"cannot be loaded as weights alone; save model.state_dict(), not the model ({first_line(error)})"
        ) from error
    for key in ("state_dict", "model", "params", "netG"):
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise FileError(path, f"its weights are not those of {type(module).__name__}: {first_line(error)}") from error


def _describe_failure(image: NDArray[np.float32], error: Exception) -> str:
    """Say in one line why a network failed on an image."""
    # TorchScript says what happened in the last line of a traceback of its own.
    is_trace = "TorchScript interpreter" in first_line(error)
    reason = str(error).strip().splitlines()[-1] if is_trace else first_line(error)
    return f"the network cannot take {(1, *image.shape)} float32, {image.shape[-3]} channels: {reason}"
