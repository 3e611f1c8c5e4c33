"""A task on denoised frames: how many of the reference's features a matcher finds again, by ORB of scikit-image.

    eldata evaluate preds --dataset eld --task eldata.examples.match_features:matches

E. Rublee, V. Rabaud, K. Konolige and G. Bradski, "ORB: an efficient alternative to SIFT or SURF", ICCV 2011. Needs
scikit-image. A detector stands in the same place: a function of both images to one number.
"""

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2gray
from skimage.feature import ORB, match_descriptors

from eldata.evaluation import Task

Image = NDArray[np.float32]

_KEYPOINTS = 300
_NEAR = 2.0  # pixels: farther away, a match is another feature that looks alike


def matched_share(prediction: Image, reference: Image) -> float:
    """Return the share of the reference's keypoints that match one of the prediction at their own place.

    Parameters
    ----------
    prediction, reference
        (3, h, w) sRGB in [0, 1].
    """
    try:
        places, descriptors = _features(reference)
    except RuntimeError as error:
        raise ValueError(f"the reference has no keypoints: {error}") from error
    try:
        own_places, own_descriptors = _features(prediction)
    except RuntimeError:  # a prediction without a single keypoint
        return 0.0
    pairs = match_descriptors(  # type: ignore[no-untyped-call]
        descriptors, own_descriptors, metric="hamming", cross_check=True
    )
    distances = np.linalg.norm(places[pairs[:, 0]] - own_places[pairs[:, 1]], axis=1)
    return float(np.count_nonzero(distances <= _NEAR) / len(places))


def _features(image: Image) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the places (n, 2) of keypoints and their descriptors (n, 256)."""
    orb = ORB(n_keypoints=_KEYPOINTS)  # type: ignore[no-untyped-call] # scikit-image has no types
    orb.detect_and_extract(rgb2gray(image.transpose(1, 2, 0)))  # type: ignore[no-untyped-call]
    return np.asarray(orb.keypoints), np.asarray(orb.descriptors)


matches = Task(matched_share, images="srgb", label="ORB matches")


if __name__ == "__main__":  # for evaluate: as a program it says what it is
    print(__doc__)
