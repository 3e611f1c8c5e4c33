"""Results of evaluations as their JSON has them, with scores drawn for the purpose, and as records."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldata.evaluation.results import EvaluationResult, saved_result
from eldata.protocols import get_protocol

DIGEST = "sha256:" + "a" * 64


def result_data(
    *,
    cameras: Sequence[str] = ("SonyA7S2", "NikonD850"), scenes: int = 8, isos: Sequence[int] = (800, 1600, 3200),
    ratios: Sequence[int] = (100, 200), protocol: str = "eld", gain_db: float = 0.0, method: int = 0,
    dataset: str = "eld",
) -> dict[str, Any]:  # fmt: skip
    """A result; ``method`` draws another method's scores of the same, equally hard images."""
    level = np.random.default_rng(1)
    noise = np.random.default_rng([2, method])
    images = []
    for camera in cameras:
        for scene in range(1, scenes + 1):
            hard = level.normal(0, 2)
            for index, (iso, ratio) in enumerate((iso, ratio) for iso in isos for ratio in ratios):
                psnr = 42 + hard - 2 * math.log2(iso / 800 * ratio / 100) + gain_db + noise.normal(0, 0.3)
                images.append(
                    {
                        "path": f"{camera}/scene-{scene}/IMG_{index + 2:04d}.ARW",
                        "camera": camera,
                        "scene": f"scene-{scene}",
                        "iso": float(iso),
                        "ratio": float(ratio),
                        "psnr_db": float(psnr),
                        "ssim": float(1 - 10 ** (-psnr / 30)),
                        "rescale": float(np.exp(noise.normal(0, 0.02))),
                    }
                )
    chosen = get_protocol(protocol)
    data = {
        "protocol": chosen.as_dict(),
        "provenance": {
            "dataset": dataset,
            "manifest_version": "1.0",
            "manifest_sha256": DIGEST,
            "protocol_digest": chosen.digest,
            "cameras": "all",
            "predictions": "/home/ada/preds/unet",
            "eldata": "0.2.0",
            "libraw": "0.22.2",
            "subset": None,
            "excluded_flags": {},
            "scenes_shared": True,
        },
        "coverage": {"pairs": len(images), "scored": len(images), "missing": []},
        "images": images,
        "table": [],
        "problems": [],
        "notes": [],
    }
    data["table"] = table_of(data)
    return data


def table_of(data: dict[str, Any], pairs: int | None = None) -> list[dict[str, Any]]:
    """The means of a result's images, camera by factor, each factor, all; ``pairs`` of the last row."""
    images = data["images"]
    cameras = list(dict.fromkeys(image["camera"] for image in images))
    ratios = sorted({image["ratio"] for image in images})
    groups = [(camera, ratio) for camera in cameras for ratio in ratios]
    groups += [(None, ratio) for ratio in ratios] if len(cameras) > 1 else []
    rows = []
    for camera, ratio in [*groups, (None, None)]:
        members = [i for i in images if camera in (None, i["camera"]) and ratio in (None, i["ratio"])]
        values = [[math.inf if i[name] == "inf" else i[name] for i in members] for name in ("psnr_db", "ssim")]
        means = [math.fsum(of) / len(of) for of in values]
        rows.append(
            {
                "camera": camera,
                "ratio": ratio,
                "pairs": len(members) if pairs is None or ratio is not None else pairs,
                "scored": len(members),
                "psnr_db": "inf" if math.isinf(means[0]) else means[0],
                "ssim": means[1],
            }
        )
    return rows


def result(**options: Any) -> EvaluationResult:
    """The same as records."""
    return saved_result(result_data(**options), "test")


def written(path: Path, data: object) -> Path:
    """Write JSON as ``eldata evaluate --json`` does."""
    path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    return path
