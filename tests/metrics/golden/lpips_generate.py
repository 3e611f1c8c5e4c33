"""Write lpips.json with the package lpips, by the authors of the metric, which the project itself does not need.

Its network is torchvision's AlexNet with the seeded weights of lpips_images.py in place of ImageNet's, so nothing is
downloaded. It computes in float32; the reference values are made in float64, so that they show the method and not its
rounding. The values in float32 are kept beside them.

Run from the root of the repository::

    python3.11 -m venv /tmp/oracle
    /tmp/oracle/bin/pip install "torch==2.13.0" "torchvision==0.28.0" "lpips==0.1.4" "scipy"
    PYTHONPATH=. /tmp/oracle/bin/python tests/metrics/golden/lpips_generate.py
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
from pathlib import Path

import numpy as np
import torch

from tests.metrics.golden.lpips_images import CASES, backbone_state, linear_state

TARGET = Path(__file__).with_name("lpips.json")
PACKAGES = ("torch", "torchvision", "lpips")


def main() -> None:
    network = importlib.import_module("lpips").LPIPS(net="alex", version="0.1", pnet_rand=True, verbose=False)
    for part in network.net.children():
        for index, layer in part.named_children():
            for name, parameter in layer.named_parameters():
                parameter.data.copy_(torch.from_numpy(backbone_state()[f"features.{index}.{name}"]))
    for name, values in linear_state().items():
        network.get_parameter(name).data.copy_(torch.from_numpy(values))
    cases = {}
    for case in CASES:
        images = [torch.from_numpy(image.astype(np.float32))[None] for image in case.make()]
        with torch.no_grad():
            cases[case.name] = {
                "lpips": network.double()(*(image.double() for image in images), normalize=True).item(),
                "in_float32": network.float()(*images, normalize=True).item(),
            }
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    TARGET.write_text(json.dumps({"made_with": versions, "cases": cases}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
