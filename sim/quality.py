"""Named rendering qualities and the point-spread function that they realise on a fine grid."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput


@dataclass(frozen=True)
class Quality:
    """How finely a frame is sampled before the point-spread function and the pixels' area are applied.

    Attributes:
        name: in the registry `QUALITIES`.
        supersampling: rendered pixels along each side of a sensor pixel; each has 4 MSAA samples.
        passes: frames averaged, with offsets of multiples of 1/(4 passes) of a rendered pixel; odd.
    """

    name: str
    supersampling: int = 1
    passes: int = 1

    def __post_init__(self) -> None:
        for name, value in (("supersampling", self.supersampling), ("passes", self.passes)):
            if not (isinstance(value, int) and 1 <= value <= 64):
                raise InvalidInput(f"quality {name} is {value!r}; accepted: a whole number from 1 to 64")
        if self.passes % 2 == 0:
            raise InvalidInput(
                f"quality passes is {self.passes}; accepted: odd numbers (even: the MSAA lattice)"
            )

    @property
    def offsets(self) -> Array:
        """Offsets (passes, 2) of the passes [rendered px], zero on average.

        MSAA's four samples stand at odd eighths of a pixel, each once along either axis. A rank-1 lattice of pitch
        1/(4 passes) between them makes all 4 passes samples equidistant along both axes: together they are the
        box of one rendered pixel, no wider.
        """
        k = np.arange(self.passes) - self.passes // 2
        other = (2 * k + self.passes // 2) % self.passes - self.passes // 2
        return np.stack([k, other], axis=1) / (4 * self.passes)


QUALITIES = {
    quality.name: quality
    for quality in (Quality("preview"), Quality("standard", 4), Quality("metrology", 4, 5))
}


def get_quality(quality: str | Quality) -> Quality:
    """A quality by its name; InvalidInput lists the names."""
    if isinstance(quality, Quality):
        return quality
    if quality not in QUALITIES:
        raise InvalidInput(f"quality is {quality!r}; accepted: {', '.join(QUALITIES)}")
    return QUALITIES[quality]


def psf_margin(blur: float) -> int:
    """Width [px] of the border that a frame needs around it, so that its edges are blurred with what is there."""
    return int(np.ceil(5 * blur)) + 1 if blur > 0 else 0


def sampling_matrix(size: int, supersampling: int, blur: float) -> sparse.csr_array:
    """Weights (size, supersampling (size + 2 margin)) from rendered pixels to sensor pixels along one axis.

    Rendered pixels are averages over 1/supersampling px. A Gaussian sampled on their grid, then the sum of
    `supersampling` of them, makes the whole: Gaussian(blur) convolved with the box of one sensor pixel.
    """
    s = supersampling
    sigma = blur * s
    if sigma >= 0.5:
        reach = int(np.ceil(5 * sigma))
        gauss = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    else:  # too narrow to be sampled: three taps of the same variance
        gauss = np.array([sigma**2 / 2, 1 - sigma**2, sigma**2 / 2])
    kernel = np.convolve(gauss / gauss.sum(), np.full(s, 1 / s))
    first = s * psf_margin(blur) - len(gauss) // 2
    rows = np.repeat(np.arange(size), len(kernel))
    columns = (s * np.arange(size)[:, None] + first + np.arange(len(kernel))).ravel()
    width = s * (size + 2 * psf_margin(blur))
    inside = (columns >= 0) & (columns < width)  # a blur of 0 has zero-weight taps outside
    weights = np.tile(kernel, size)[inside]
    return sparse.csr_array(
        (weights.astype(np.float32), (rows[inside], columns[inside])), shape=(size, width)
    )
