"""`python -m eldata.examples.check_noise_model`: judge a noise model of somebody else's against held-out frames.

FRAMES holds CAMERA/bias/ISO100/... and, if there are flats, CAMERA/flat/ISO100/...; frames that neither the profile nor
the training has seen. The model here, a torch "network", adds Gaussian noise of the profile's variance; copy the file
and put yours in its place. Training on its noise: eldata.examples.train_denoiser with --noise
eldata.examples.check_noise_model:model.

    python -m eldata.examples.check_noise_model calibration/held-out profile.json page.html
"""

import sys
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from eldata.base import console
from eldata.calibration import check_noise
from eldata.noise import CameraProfile, NoiseParameters


class GaussianNetwork(torch.nn.Module):
    """Stands for a flow, a GAN or a diffusion model: clean packed images (N, C, h, w) in, noisy ones out."""

    def forward(self, clean: torch.Tensor, variance: torch.Tensor) -> torch.Tensor:
        """Return clean data with noise of a variance per pixel, from torch's own generator, as most networks do."""
        return clean + variance.sqrt() * torch.randn_like(clean)


class Adapter:
    """Calls the network as eldata calls every noise model: one image (C, h, w), normalised, at a ratio.

    check_noise takes it, and so do SyntheticPairs(model=...) and SyntheticClips(model=...).
    """

    def __init__(self, network: torch.nn.Module, device: str = "cpu") -> None:
        self.network, self.device = network.eval().to(device), torch.device(device)

    def __repr__(self) -> str:
        return f"Adapter({type(self.network).__name__})"

    def __call__(
        self,
        clean: NDArray[np.float32],
        *,
        parameters: NoiseParameters,
        ratio: float,
        range_dn: float,
        generator: np.random.Generator,
    ) -> NDArray[np.float32]:
        """Return a noisy exposure; what the network wants to know is made of the parameters."""
        image = torch.from_numpy(clean).to(self.device)
        image = (image if image.ndim == 4 else image[None]) / ratio  # as bright as the sensor saw it; a clip is a batch
        gain, read = parameters.gain_dn_per_e / range_dn, parameters.sigma_gauss_dn / range_dn
        variance = gain * image.clamp(min=0) + read**2
        devices = [] if self.device.type == "cpu" else [self.device]
        with torch.inference_mode(), torch.random.fork_rng(devices):
            torch.manual_seed(int(generator.integers(2**63 - 1)))  # all randomness comes from the caller
            noisy: torch.Tensor = self.network(image, variance)
        return (noisy * ratio).reshape(clean.shape).cpu().numpy()


model = Adapter(GaussianNetwork())


def main(frames: Path, profile: str, page: Path | None = None) -> int:
    """Print the table, and write the page if it is asked for."""
    found = check_noise(model, frames, CameraProfile.load(profile))
    print(found.format_text())
    if page is not None:
        from eldata.reports.noise_models import acceptance_page

        page.write_text(acceptance_page(found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    parser = console.document(console.Parser(prog="python -m eldata.examples.check_noise_model"), __doc__)
    parser.add_argument("frames", type=Path, metavar="FRAMES", help="folder of the held-out frames")
    parser.add_argument("profile", metavar="PROFILE", help="a shipped profile or a JSON file")
    parser.add_argument("page", type=Path, nargs="?", metavar="PAGE", help="HTML page to write")
    parser.set_defaults(run=lambda chosen: main(chosen.frames, chosen.profile, chosen.page), running=["debug"])
    sys.exit(console.run(parser, None))
