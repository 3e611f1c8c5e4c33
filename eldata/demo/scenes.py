"""Procedural still lifes for the demo's simulated camera: test charts and objects on an optical table.

Everything is drawn in linear light on a *stage*: three units wide and two high, the origin in the middle,
``y`` downwards, fitted into the picture whatever its shape. Painted layers hold reflectance; one lamp with a
gentle fall-off turns them into radiance at the end. So a patch's radiance is its declared colour times the
light at that place, and a scene looks the same at every size. Edges are anti-aliased analytically, from
signed distances in pixels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    Field: TypeAlias = NDArray[np.floating[Any]]
    Tone: TypeAlias = Callable[[Field, Field], Field]
    Window: TypeAlias = tuple[slice, slice]

# The 24 patches of the classic chart as published in 8-bit sRGB, row by row, the greys last.
CHART_SRGB: Final = (
    (115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170),
    (214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46),
    (56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161),
    (243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52),
)  # fmt: skip

WHITE: Final = 0.92  # the reflectance of paper
INK: Final = 0.02  # and of what is printed on it
TABLE_EDGE: Final = 0.42  # where the wall ends and the table begins
VANISHING: Final = -0.55  # the table's horizon, behind the wall

TITLES: Final = ("Colour chart", "Resolution", "Gradients and texture", "Lettering and objects")
LINES: Final = (
    "photons arrive one by one", "every digit has a source", "dark frames do not lie", "shot noise is honest",
    "count what the light left", "the quick brown fox naps", "read noise 1.8 e-, gain 4.2",
    "signal first, then noise",
)  # fmt: skip


def scene_title(number: int) -> str:
    """Return the title of scene ``number``, such as ``"Colour chart"``."""
    variation, kind = divmod(number - 1, len(TITLES))
    return TITLES[kind] + (f", variation {variation}" if variation else "")


def scene_radiance(number: int, height: int, width: int) -> NDArray[np.float32]:
    """Return the linear radiance of a still life.

    Parameters
    ----------
    number
        Which scene, from 1. Scenes 1 to 4 are a colour chart, resolution targets, gradients and texture, and
        lettering and objects; higher numbers repeat the four with other lighting, hues, words and layout.
    height, width
        The size in pixels, each at least 64. The composition is made for 3:2.

    Returns
    -------
    numpy.ndarray
        float32 of shape (3, height, width): linear light in sRGB primaries, between 0 and 1, where 1 is the
        brightest diffuse white or a highlight.
    """
    stage = _Stage(number, height, width)
    COMPOSITIONS[stage.kind](stage)
    return stage.radiance()


def linear_light(srgb: ArrayLike) -> Field:
    """Return 8-bit sRGB values as linear light."""
    value = np.asarray(srgb, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _hue(turn: ArrayLike, paleness: float = 0.0) -> Field:
    """Return the linear colour of a hue in turns, its channels along the first axis."""
    turn = np.asarray(turn, np.float32)
    channels = np.stack([np.abs((6 * turn + shift) % 6 - 3) - 1 for shift in (0.0, 4.0, 2.0)])
    return np.asarray(paleness + (1 - paleness) * np.clip(channels, 0, 1) ** 2, np.float32)


def _box(x: Field, y: Field, half_width: float, half_height: float, radius: float = 0.0) -> Field:
    """Return the signed distance to a box around the origin whose corners are rounded."""
    dx, dy = np.abs(x) - (half_width - radius), np.abs(y) - (half_height - radius)
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0))
    return np.asarray(outside + np.minimum(np.maximum(dx, dy), 0) - radius, np.float32)


def _texture(rng: np.random.Generator, height: int, width: int) -> Field:
    """Return 1/f noise of zero mean and unit deviation, without the finest detail."""
    side = 512  # fixed, so that the texture does not depend on the picture's size
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :]
    frequency = np.maximum(np.hypot(fy, fx), 2 / side)
    shape = np.exp(-((frequency / 0.25) ** 2)) / frequency
    shape[0, 0] = 0
    spectrum = shape * np.fft.rfft2(rng.standard_normal((side, side)))
    noise = np.fft.irfft2(spectrum, s=(side, side)).astype(np.float32)
    long = max(height, width)
    scaled = Image.fromarray(noise / noise.std()).resize((long, long), Image.Resampling.BICUBIC)
    return np.asarray(scaled, np.float32)[:height, :width]


class _Stage:
    """The picture while it is painted: a reflectance and a gloss layer, the lamp, and the pixel grid."""

    def __init__(self, number: int, height: int, width: int) -> None:
        self.variation, self.kind = divmod(number - 1, len(TITLES))
        self.rng = np.random.default_rng([0xE1DA7A, number])
        self.scale = min(width / 3, height / 2)  # pixels per unit
        self.x: Field = ((np.arange(width, dtype=np.float32) + 0.5 - width / 2) / self.scale)[None, :]
        self.y: Field = ((np.arange(height, dtype=np.float32) + 0.5 - height / 2) / self.scale)[:, None]
        self.colour = np.zeros((3, height, width), np.float32)
        self.gloss = np.zeros((height, width), np.float32)
        # The four base scenes have a hand-picked look; the seed only moves the variations away from it.
        drift = self.rng.uniform(-1, 1, 4) * (self.variation > 0)
        self.hue = ((0.60, 0.50, 0.74, 0.07)[self.kind] + 0.5 * drift[0]) % 1
        self.side = -1.0 if drift[1] < 0 else 1.0  # -1 mirrors the layout and moves the lamp across
        self.lamp = (self.side * (-0.55 + 0.25 * drift[2]), -0.45 + 0.2 * drift[3])
        self.texture = _texture(self.rng, height, width)
        self.light = self._make_light()
        self._paint_backdrop()

    def _make_light(self) -> Field:
        """Make the illumination, a warm lamp and a faint cool fill, as (3, height, width)."""
        reach = ((self.x - self.lamp[0]) / 1.6) ** 2 + ((self.y - self.lamp[1]) / 1.35) ** 2
        key = (1 + reach) ** -1.7
        warm, cool = np.array([1.0, 0.955, 0.88]), np.array([0.008, 0.011, 0.016])
        return np.asarray(warm[:, None, None] * key + cool[:, None, None] * (1 - key), np.float32)

    def _paint_backdrop(self) -> None:
        """Paint a mottled wall, and a table whose threaded holes recede to the horizon."""
        self.colour[:] = (0.13 * _hue(self.hue, 0.32))[:, None, None]
        self.colour *= np.exp((0.30 if self.kind == 2 else 0.16) * self.texture)
        corner = 1 - 0.45 * np.exp(-(((self.y - TABLE_EDGE) / 0.05) ** 2))  # less light where they meet
        self.colour *= corner
        top = int(np.searchsorted(self.y[:, 0], TABLE_EDGE - 1 / self.scale))
        here: Window = (slice(top, None), slice(None))
        y = self.y[top:]
        depth = (1 - VANISHING) / (y - VANISHING)
        across, along = (self.x * depth) / 0.13, depth / 0.095  # in units of the holes' pitch
        u, v = across - np.round(across), along - np.round(along)
        distance = np.hypot(u, v) + 1e-6
        # The distance in pixels: divided by how fast it changes from one pixel to the next.
        change = np.hypot(u * depth / 0.13, v * depth**2 / (1 - VANISHING) / 0.095) / distance / self.scale
        holes = np.clip(0.5 - (distance - 0.17) / change, 0, 1) * np.clip(1.6 - 3 * change, 0, 1)
        steel = 0.10 * np.exp(0.05 * self.texture[top:]) * (1.25 - 0.3 * depth)
        self.paint(TABLE_EDGE - y, steel * corner[top:] * (1 - 0.86 * holes), here)

    def window(self, left: float, top: float, right: float, bottom: float) -> Window:
        """Return the pixels of a rectangle with a margin for its soft edge; it may be empty."""
        edges = []
        for axis, low, high in ((self.y[:, 0], top, bottom), (self.x[0], left, right)):
            first, last = np.searchsorted(axis, [low - 2 / self.scale, high + 2 / self.scale])
            edges.append(slice(int(first), int(last)))
        return edges[0], edges[1]

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return a place in the picture, in pixels from the left and from the top."""
        height, width = self.gloss.shape
        return x * self.scale + width / 2, y * self.scale + height / 2

    def grid(self, here: Window, cx: float = 0.0, cy: float = 0.0, turn: float = 0.0) -> tuple[Field, Field]:
        """Return a window's coordinates around a centre, turned by an angle in radians."""
        x, y = np.broadcast_arrays(self.x[:, here[1]] - float(cx), self.y[here[0]] - float(cy))
        cos, sin = float(np.cos(turn)), float(np.sin(turn))
        return x * cos + y * sin, y * cos - x * sin

    def paint(self, distance: Field, colour: ArrayLike, here: Window) -> None:
        """Cover a shape, given by the signed distance to its edge, with a colour."""
        self.blend(np.asarray(np.clip(0.5 - distance * self.scale, 0, 1)), colour, here)

    def blend(self, cover: Field, colour: ArrayLike, here: Window) -> None:
        """Mix in a colour (one number, three, or a picture); what lay below, highlights too, is hidden."""
        paint = np.asarray(colour, np.float32)
        layer = self.colour[:, here[0], here[1]]
        layer += cover * ((paint if paint.ndim >= 2 else paint.reshape(-1, 1, 1)) - layer)
        self.gloss[here] *= 1 - cover

    def shade(self, shadow: Field, here: Window) -> None:
        """Darken by a soft shadow."""
        self.colour[:, here[0], here[1]] *= 1 - shadow

    def fill(
        self, cx: float, cy: float, width: float, height: float, tone: Tone | ArrayLike, turn: float = 0.0,
        radius: float = 0.0,
    ) -> None:  # fmt: skip
        """Fill a box with one colour, or with a function of coordinates that run over it from 0 to 1."""
        spread = abs(np.sin(turn))
        across, down = (width + spread * height) / 2, (height + spread * width) / 2
        here = self.window(cx - across, cy - down, cx + across, cy + down)
        x, y = self.grid(here, cx, cy, turn)
        if callable(tone):
            tone = tone(np.clip(x / width + 0.5, 0, 1), np.clip(y / height + 0.5, 0, 1))
        self.paint(_box(x, y, width / 2, height / 2, radius), tone, here)

    def panel(self, cx: float, cy: float, width: float, height: float, colour: ArrayLike) -> None:
        """Stand up a board with a soft shadow that falls away from the lamp."""
        across, down = width / 2 + 0.2, height / 2 + 0.2
        here = self.window(cx - across, cy - down, cx + across, cy + down)
        x, y = self.grid(here, cx + 0.03 * np.sign(cx - self.lamp[0]), cy + 0.035)
        depth = np.clip(_box(x, y, width / 2, height / 2, 0.03) / 0.03, -30, 30)
        self.shade(0.75 / (1 + np.exp(depth)), here)
        self.fill(cx, cy, width, height, colour, radius=0.02)

    def waves(self, phase: Field, period: Field | float) -> Field:
        """Return anti-aliased black and white bars: phase in turns, local period in units."""
        pixels = np.asarray(period * self.scale, np.float32)
        edge = np.abs((phase + 0.25) % 1 - 0.5) - 0.25  # the distance to the nearest edge, in turns
        bars = np.clip(0.5 + edge * pixels, 0, 1)
        seen = np.clip((pixels - 1.5) / 1.5, 0, 1)  # bars finer than the pixels fade to grey
        return np.asarray(INK + (WHITE - INK) * (0.5 + (bars - 0.5) * seen))

    def bars(self, cx: float, cy: float, size: float, period: float) -> None:
        """Draw a square of upright bars and, below it, one of level bars."""
        self.fill(cx, cy - 0.6 * size, size, size, lambda u, _: self.waves(u * (size / period), period))
        self.fill(cx, cy + 0.6 * size, size, size, lambda _, v: self.waves(v * (size / period), period))

    def wedge(self, steps: Field, size: float) -> Field:
        """Return greys that each reflect 1/sqrt(2) of the one before; a step has this size in units."""
        edge = np.round(steps)
        level = edge - 1 + np.clip(0.5 + (steps - edge) * size * self.scale, 0, 1)
        return np.asarray(WHITE * 2 ** (-np.clip(level, 0, 10) / 2))

    def star(self, cx: float, cy: float, radius: float, spokes: int) -> None:
        """Draw a Siemens star."""
        here = self.window(cx - radius, cy - radius, cx + radius, cy + radius)
        x, y = self.grid(here, cx, cy)
        r = np.hypot(x, y)
        bars = self.waves(np.arctan2(y, x) * (spokes / (2 * np.pi)), 2 * np.pi * r / spokes)
        self.paint(r - radius, bars, here)

    def chart(self, cx: float, cy: float, pitch: float) -> None:
        """Draw the 24-patch chart in its dark frame; variations turn it upside down or mirror it."""
        self.panel(cx, cy, 6.3 * pitch, 4.3 * pitch, 0.018)
        patches = linear_light(CHART_SRGB).reshape(4, 6, 3)
        patches = patches[:: -1 if self.variation % 2 else 1, :: int(self.side)]
        for (row, column), _ in np.ndenumerate(patches[..., 0]):
            x, y = cx + (column - 2.5) * pitch, cy + (row - 1.5) * pitch
            self.fill(x, y, 0.86 * pitch, 0.86 * pitch, patches[row, column])

    def write(self, x: float, y: float, size: float, text: str, colour: ArrayLike, anchor: str = "lm") -> None:
        """Write a line of text; the size is the font's, in units."""
        mask = Image.new("L", self.gloss.shape[::-1])
        font = ImageFont.load_default(max(size * self.scale, 1.0))
        ImageDraw.Draw(mask).text(self.pixel(x, y), text, fill=255, font=font, anchor=anchor)
        if (bounds := mask.getbbox()) is not None:
            here = (slice(bounds[1], bounds[3]), slice(bounds[0], bounds[2]))
            self.blend(np.asarray(mask.crop(bounds), np.float32) / 255, colour, here)

    def sphere(
        self, cx: float, base: float, radius: float, colour: ArrayLike, shine: float = 1.0, grain: float = 0.0
    ) -> None:
        """Put a ball on the table at height ``base``: matte to glossy, and smooth to rough like stone."""
        cy = base - radius
        away = float(np.sign(cx - self.lamp[0]))
        here = self.window(cx - 3 * radius, cy, cx + 3 * radius, base + radius)
        x, y = self.grid(here, cx + 0.45 * away * radius, base - 0.06 * radius)
        self.shade(0.85 * np.exp(-((x / (1.15 * radius)) ** 2) - (y / (0.2 * radius)) ** 2), here)
        here = self.window(cx - radius, cy - radius, cx + radius, cy + radius)
        x, y = self.grid(here, cx, cy)
        x, y = x / radius, y / radius
        z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
        lamp = np.array([self.lamp[0] - cx, self.lamp[1] - cy, 1.0])
        lamp /= np.linalg.norm(lamp)
        half = lamp + np.array([0.0, 0.0, 1.0])  # halfway between lamp and viewer, where it glints
        half /= np.linalg.norm(half)
        lit = np.clip(lamp[0] * x + lamp[1] * y + lamp[2] * z, 0, 1)
        glint = np.clip(half[0] * x + half[1] * y + half[2] * z, 0, 1) ** 250
        tone = (0.05 + 0.95 * lit + 0.07 * np.clip(y, 0, 1)) * np.exp(grain * self.texture[here])
        self.paint((np.hypot(x, y) - 1) * radius, np.reshape(colour, (3, 1, 1)) * tone, here)
        self.gloss[here] += 1.6 * shine * glint * (z > 0)

    def post(self, cx: float, top: float, base: float, radius: float) -> None:
        """Stand a steel optical post on the table."""
        foot, neck = 2.4 * radius, base - 0.07
        here = self.window(cx - 3 * foot, neck, cx + 3 * foot, base + foot)
        x, y = self.grid(here, cx, base)
        self.shade(0.8 * np.exp(-((x / (1.6 * foot)) ** 2) - (y / (0.5 * foot)) ** 2), here)
        self.fill(cx, (neck + base) / 2, 2 * foot, base - neck, self.steel, radius=0.3 * radius)
        self.fill(cx, (top + neck) / 2, 2 * radius, neck - top, self.steel, radius=0.3 * radius)

    def steel(self, u: Field, _: Field) -> Field:
        """Return the reflections across a polished cylinder: the lamp's streak and a fainter one."""
        across = (2 * u - 1) * self.side
        streak, faint = np.exp(-(((across + 0.4) / 0.2) ** 2)), np.exp(-(((across - 0.65) / 0.15) ** 2))
        return np.asarray(0.1 + 0.75 * streak + 0.2 * faint)

    def hues(self, *picked: float) -> tuple[float, ...]:
        """Return the hand-picked hues, or others in a variation."""
        return tuple((hue + float(self.rng.uniform()) * bool(self.variation)) % 1 for hue in picked)

    def radiance(self) -> NDArray[np.float32]:
        """Return the light that reaches the camera."""
        return np.asarray(np.clip(self.colour * self.light + self.gloss, 0, 1), np.float32)


def _paint_chart(stage: _Stage) -> None:
    """Paint a colour chart, a step wedge and balls."""
    m = stage.side
    stage.post(1.31 * m, -0.50, 0.60, 0.045)
    stage.chart(-0.40 * m, -0.04, 0.282)
    stage.panel(0.76 * m, 0.02, 0.34, 1.09, 0.018)
    stage.fill(0.76 * m, 0.021, 0.27, 1.012, lambda _, v: stage.wedge(11 * v, 1.012 / 11))
    hues = stage.hues(0.055, 0.50, 0.93)
    stage.sphere(1.04 * m, 0.86, 0.185, 0.8 * _hue(hues[0], 0.06))
    stage.sphere(0.58 * m, 0.89, 0.105, 0.7 * _hue(hues[1], 0.12), 0.8)
    stage.sphere(-1.22 * m, 0.86, 0.125, 0.7 * _hue(hues[2], 0.10), 0.6)


def _paint_bars(stage: _Stage) -> None:
    """Paint a Siemens star, slanted edges and bars of five frequencies."""
    m = stage.side
    stage.panel(-0.62 * m, -0.09, 1.30, 1.30, WHITE)
    stage.star(-0.62 * m, -0.09, 0.57, (36, 48, 24, 60)[stage.variation % 4])
    for dx, dy in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        stage.fill(-0.62 * m + 0.56 * dx, -0.09 + 0.56 * dy, 0.09, 0.09, INK, np.pi / 4)
    tilt = 5 + stage.variation % 4
    for x, paper, ink, degrees in ((0.37, WHITE, INK, tilt), (1.01, INK, WHITE, -12)):
        stage.panel(x * m, -0.42, 0.56, 0.64, paper)
        stage.fill(x * m, -0.46, 0.31, 0.31, ink, np.deg2rad(degrees) * m)
        stage.write(x * m, -0.17, 0.075, f"slanted {abs(degrees)}°", ink, "mm")
    stage.panel(0.69 * m, 0.24, 1.20, 0.60, WHITE)
    for column in range(5):
        x, pairs = (0.69 + 0.23 * (column - 2)) * m, 25 * 2 ** (column / 2)  # line pairs per picture height
        stage.bars(x, 0.195, 0.20, 2 / pairs)
        stage.write(x, 0.475, 0.07, f"{pairs:.0f}", INK, "mm")
    hues = stage.hues(0.60, 0.10)
    stage.sphere(0.02 * m, 0.86, 0.135, 0.7 * _hue(hues[0], 0.10))
    stage.sphere(0.28 * m, 0.90, 0.08, 0.8 * _hue(hues[1], 0.08), 0.8)


def _paint_gradients(stage: _Stage) -> None:
    """Paint gradients of hue and grey, a glow and balls."""
    m = stage.side
    stage.panel(-0.52 * m, -0.47, 1.50, 0.62, 0.03)
    stage.fill(-0.52 * m, -0.61, 1.40, 0.24, lambda u, _: 0.9 * _hue(u + stage.hue, 0.04))
    stage.fill(-0.52 * m, -0.39, 1.40, 0.10, lambda u, _: 0.003 * (WHITE / 0.003) ** u)
    stage.fill(-0.52 * m, -0.25, 1.40, 0.10, lambda u, _: WHITE * u)
    stage.panel(0.80 * m, -0.20, 0.86, 1.16, 0.03)
    stage.fill(0.80 * m, -0.20, 0.76, 1.06, lambda u, v: _glow(stage.hue, u - 0.5, (v - 0.5) * 1.4))
    stage.panel(-0.52 * m, 0.17, 1.50, 0.60, 0.03)
    for column, hue in enumerate((0.0, 1 / 3, 2 / 3)):
        stage.fill((-0.52 + 0.475 * (column - 1)) * m, 0.17, 0.45, 0.50, _ramp(hue))
    hues = stage.hues(0.09, 0.58, 0.36)
    stage.sphere(0.42 * m, 0.84, 0.26, 0.55 * _hue(hues[0], 0.35), 0.05, 0.24)
    stage.sphere(0.98 * m, 0.80, 0.19, 0.6 * _hue(hues[1], 0.15), 0.9)
    stage.sphere(-1.12 * m, 0.85, 0.15, 0.5 * _hue(hues[2], 0.25), 0.05, 0.18)


def _ramp(hue: float) -> Tone:
    """Return a downward ramp of one hue."""
    ink = _hue(hue, 0.03)[:, None, None]
    return lambda _, v: np.asarray(ink * (0.002 + v**2))


def _glow(hue: float, x: Field, y: Field) -> Field:
    """Return a radial gradient in hue and brightness."""
    r = np.hypot(x, y)
    return np.asarray(0.004 + 0.9 * _hue(hue + 0.36 - 0.55 * r, 0.10) * np.exp(-((r / 0.40) ** 2)))


def _paint_letters(stage: _Stage) -> None:
    """Paint two boards of text in falling sizes, and balls."""
    m, first = stage.side, int(stage.rng.integers(len(LINES))) * bool(stage.variation)
    lines = LINES[first:] + LINES[:first]
    stage.panel(-0.58 * m, -0.12, 1.46, 1.24, WHITE)
    left = -0.58 * m - 0.66
    stage.write(left, -0.52, 0.42, "eldata", 0.7 * _hue(stage.hue, 0.02))
    for row, size in enumerate((0.102, 0.086, 0.072, 0.060, 0.050, 0.042)):
        stage.write(left, -0.20 + 0.56 * (1 - 0.82**row) / 0.82, size, lines[row], INK)
    stage.panel(0.78 * m, -0.27, 1.04, 0.94, 0.012)
    left = 0.78 * m - 0.45
    stage.write(left, -0.55, 0.25, "3.2 e-", WHITE)
    for row, size in enumerate((0.078, 0.066, 0.054, 0.043)):
        tone = WHITE * 0.5**row if row < 3 else _hue(stage.hue, 0.1)
        stage.write(left, -0.33 + 0.13 * row, size, lines[-1 - row], tone)
    hues = stage.hues(0.02, 0.13, 0.55, 0.62)
    stage.post(1.22 * m, 0.12, 0.66, 0.045)
    stage.sphere(0.38 * m, 0.72, 0.20, 0.75 * _hue(hues[0], 0.03))
    stage.sphere(0.80 * m, 0.80, 0.24, [0.62, 0.62, 0.60], 0.1)
    stage.sphere(1.06 * m, 0.90, 0.11, 0.85 * _hue(hues[1], 0.03), 0.9)
    stage.sphere(-0.30 * m, 0.84, 0.13, 0.7 * _hue(hues[2], 0.05), 0.9)
    stage.sphere(-0.98 * m, 0.86, 0.16, 0.5 * _hue(hues[3], 0.12), 0.9)


COMPOSITIONS: Final[Sequence[Callable[[_Stage], None]]] = (_paint_chart, _paint_bars, _paint_gradients, _paint_letters)
