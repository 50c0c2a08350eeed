"""Night out of day, for fit.py: what the sun lit is lit by lamps, and a sensor sees it with noise.

The essentials of `src/training/augmentation`, at the size of the network's input: light is linear, lamps stand
below the sky and light what is near them, the sky goes dark, some panes are lit.
"""

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LAMP_KELVIN = [2000, 2700, 4000, 6000]


def decoded(level):
    """Light of an sRGB level, both 0 to 1 (IEC 61966-2-1)."""
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def encoded(light):
    """sRGB level of light; light beyond 1 is cut off."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def black_body(kelvin):
    """Colour of a black body with luminance of about 1 (chromaticity: Kim et al., 2002)."""
    t = 1000 / np.clip(kelvin, 1667, 25000)
    if t > 0.25:
        x = ((-0.2661239 * t - 0.234358) * t + 0.8776956) * t + 0.17991
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.24039
    if t > 0.45:
        y = ((-1.1063814 * x - 1.3481102) * x + 2.18555832) * x - 0.20219683
    elif t > 0.25:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.081758 * x - 5.8733867) * x + 3.75112997) * x - 0.37001483
    x, z = x / y, (1 - x - y) / y
    return np.maximum([3.2406 * x - 1.5372 - 0.4986 * z, -0.9689 * x + 1.8758 + 0.0415 * z, 0.0557 * x - 0.2040 + 1.0570 * z], 0)


def sky_of(luminance):
    """Where the sky or a bright ceiling is: bright from the top down; none if it reaches the ground."""
    side, mean = len(luminance), luminance.mean()
    rows = np.arange(side)[:, None]
    sky = np.cumprod((luminance > 0.6 * mean) & (rows < 0.75 * side), 0).astype(bool) & (luminance.max(0) > 0.9 * mean)
    return sky & ~sky[int(0.7 * side):].any()


def fall(day, random):
    """The light of the same view by night; `day` is light, [side, side, 3]."""
    side = len(day)
    down, across = np.mgrid[:side, :side].astype(np.float32)
    luminance = day @ LUMINANCE
    mean, sky = luminance.mean(), sky_of(luminance)
    ends = sky.sum(0)
    ambient = 2 ** random.uniform(-5, -1.5) * black_body(2 ** random.uniform(-1, 1) * 5500)
    light, lamps = np.ones((side, side, 3)) * ambient, []
    for _ in range(random.integers(2, 14)):
        x, nearness = random.uniform() * side, random.uniform() ** 2
        below, size = random.uniform(0.02, 0.15) + 0.3 * nearness * random.uniform(), random.uniform(0.7, 1.3)
        y = min(ends[int(x)], 0.6 * side) + below * side
        radius, reach = side * size * (0.002 + 0.009 * nearness), side * size * (0.04 + 0.25 * nearness)
        colour, brightness = black_body(random.choice(LAMP_KELVIN) * random.uniform(0.9, 1.1)), random.uniform(2, 12)
        root = 1 + ((across - x) ** 2 + (down - y - 0.4 * reach) ** 2) / reach**2
        light += colour * brightness / 7 * (1 / root**2)[..., None]
        lamps.append((x, y, radius, colour * brightness))
    scene = day * np.where(sky[..., None], ambient * 2 ** random.uniform(-5, -1), light)
    scene *= random.uniform(0.03, 0.15) * mean / max((scene @ LUMINANCE).mean(), 1e-9)
    if random.uniform() < 0.5:
        light_windows(scene, luminance, random)
    for x, y, radius, colour in lamps:
        squared = ((across - x) ** 2 + (down - y) ** 2) / radius**2
        halo = (1 / (1 + squared) ** 2 + 0.01 / (1 + squared / 64) ** 2) * (squared < 1024)
        scene += halo[..., None] * colour
    return scene


def light_windows(scene, luminance, random):
    """Lights panes in place: what is darker by day than its surroundings."""
    side = len(scene)
    for _ in range(random.integers(0, 40)):
        x, y = random.integers(0, side, 2)
        wide = max(int(side * random.uniform(0.004, 0.02)), 1)
        high = max(int(wide * random.uniform(0.8, 2)), 1)
        pane = np.s_[max(y - high, 0):y + high + 1, max(x - wide, 0):x + wide + 1]
        around = np.median(luminance[max(y - 3 * high, 0):y + 3 * high + 1, max(x - 3 * wide, 0):x + 3 * wide + 1])
        if luminance[y, x] < 0.75 * around:
            lit = random.uniform(0.1, 0.7) * black_body(random.uniform(2300, 4500))
            scene[pane] = np.maximum(scene[pane], np.where((luminance[pane] < 0.75 * around)[..., None], lit, 0))


def photographed(picture, random):
    """Levels 0 to 1 of a night, from those of a day, through a lens that darkens the corners and a noisy sensor."""
    light = fall(decoded(picture ** 2 ** random.uniform(-0.5, 0.5)), random)
    off_axis = np.linspace(-1, 1, len(light)) ** 2
    light /= (1 + (off_axis[:, None] + off_axis)[..., None] / 2 * np.tan(random.uniform(0.2, 0.6)) ** 2) ** 2
    white_electrons = 2 ** random.uniform(9, 13)
    noise = random.normal(size=light.shape)
    light = light + noise * np.sqrt(np.maximum(light, 0) / white_electrons + (random.uniform(2, 6) / white_electrons) ** 2)
    return encoded(light * random.uniform(1, 4) if random.uniform() < 0.5 else light)
