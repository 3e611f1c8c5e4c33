"""`python -m eldata.examples.score_model`: denoise ELD's noisy frames with a model of yours, and score that.

The predictions of all pairs that the protocol scores are written, and the table is printed.

    python -m eldata.examples.score_model data/ELD preds/gaussian
    python -m eldata.examples.score_model eldata-demo/data/ELD-demo preds/gaussian eldata-demo/manifests/eld-demo.csv

The "model" here is a Gaussian blur; copy the file and put your network in its place.
"""

import sys
from pathlib import Path

import torch
from torch.utils.data import DataLoader

from eldata import ELDDataset, evaluate
from eldata.base import console
from eldata.evaluation import save_prediction


def model(noisy: torch.Tensor) -> torch.Tensor:
    """Blur each packed channel, (N, 4, h, w), with a 5x5 binomial kernel."""
    row = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0])
    kernel = (torch.outer(row, row) / 256).expand(noisy.shape[1], 1, 5, 5)
    padded = torch.nn.functional.pad(noisy, (2, 2, 2, 2), mode="reflect")
    return torch.nn.functional.conv2d(padded, kernel, groups=noisy.shape[1])


def main(root: Path, predictions: Path, manifest: str = "eld") -> int:
    """Predict every pair of the protocol, then print the table."""
    dataset = ELDDataset(root, manifest=manifest)
    print(dataset)
    # Frames of different cameras differ in size, so one per batch; the workers decode.
    for batch in DataLoader(dataset, batch_size=1, num_workers=2):
        with torch.no_grad():
            output = model(batch["input"])
        save_prediction(predictions, batch["path"][0], output[0].numpy())
    own = None if manifest == "eld" else manifest
    print(evaluate(predictions, manifest=own, root=root.parent, workers=2).format_text())
    return 0


if __name__ == "__main__":  # spawned workers import this file: the guard is needed
    parser = console.document(console.Parser(prog="python -m eldata.examples.score_model"), __doc__)
    parser.add_argument("root", type=Path, metavar="FOLDER", help="of the set itself, such as data/ELD")
    parser.add_argument("predictions", type=Path, metavar="OUT", help="folder of the predictions")
    parser.add_argument("manifest", nargs="?", default="eld", metavar="MANIFEST", help="of a set in ELD's layout")
    parser.set_defaults(run=lambda chosen: main(chosen.root, chosen.predictions, chosen.manifest), running=["debug"])
    sys.exit(console.run(parser, None))
