"""The figures that the sources print, as they print them, misprints included.

Roháček 2022, "Improving probes in dynamic diffuse global illumination" (Charles University), chapter 4.
Ekberg 2022, "Diffuse Global Illumination using Surfels" (Chalmers University of Technology), chapter 5.
"""

from __future__ import annotations

ROHACEK_SOURCE = "Roháček 2022, Improving probes in dynamic diffuse global illumination, chapter 4"
EKBERG_SOURCE = "Ekberg 2022, Diffuse Global Illumination using Surfels, chapter 5"

FULL_HD = 1920 * 1080
"""Pixels of the images that both sources measured."""

# ---------- Roháček 2022 ----------

MEMORY = (
    (8, 8, "float16", "float16", 1200),
    (8, 16, "float16", "float16", 2096),
    (8, 32, "float16", "float16", 5424),
    (8, 8, "float16", "float32", 1600),
    (8, 16, "float16", "float32", 3392),
    (8, 32, "float16", "float32", 10048),
    (16, 16, "float16", "float16", 3888),
    (32, 16, "float16", "float16", 10544),
)
"""Table 4.1: irradiance and depth resolution, irradiance and depth format, bytes a probe."""

DEAD_PROBES = {
    "only direct light": (2294603, 1.106580, 2.925490),
    "simple DDGI": (329610, 0.158956, 1.678431),
    "offset to the surface": (322392, 0.155475, 1.807843),
    "offset 15 cm away": (322293, 0.155427, 1.701961),
    "improved filtering": (326027, 0.157228, 1.647059),
}
"""Table 4.2: absolute error summed over the image, its mean and its maximum."""

DEPTH_ERROR = {
    (8, False): (0.24873, 1.01569),
    (16, False): (0.23829, 1.00392),
    (32, False): (0.21507, 1.04706),
    (64, False): (0.18097, 0.96078),
    (16, True): (0.15507, 0.88235),
}
"""Table 4.3: depth resolution and whether far samples are rejected -> mean and maximum error."""

DEPTH_DETAIL = {
    (8, 8, False): (0.24058, 10.19333, 0.00090),
    (16, 8, False): (0.23093, 1.02153, 0.00424),
    (32, 8, False): (0.21207, 1.00282, 0.00333),
    (64, 8, False): (0.17781, 1.00078, 0.00133),
    (8, 16, False): (0.23795, 1.01557, 0.00204),
    (16, 16, False): (0.21916, 1.02145, 0.00616),
    (32, 16, False): (0.20792, 1.00000, 0.00424),
    (64, 16, False): (0.18398, 1.01533, 0.00263),
    (8, 8, True): (0.11866, 0.71667, 0.00200),
    (16, 8, True): (0.12381, 0.72020, 0.00314),
}
"""Table 4.4: depth resolution, bits a component, rejection -> mean, maximum and minimum."""

MAP_RESOLUTION = {
    (2, 8): (0.23159, 2.41961, 1392.2),
    (4, 8): (0.22445, 2.43529, 1521.1),
    (8, 8): (0.22374, 2.43922, 1933.6),
    (16, 8): (0.22220, 2.67451, 3377.3),
    (32, 8): (0.22430, 2.67451, 8739.8),
    (64, 8): (0.22031, 2.67451, 29364.8),
    (16, 2): (0.24147, 2.67451, 2294.5),
    (16, 4): (0.22525, 2.67451, 2552.3),
    (16, 16): (0.22421, 2.67451, 6264.8),
    (16, 32): (0.22420, 2.67451, 16989.8),
    (16, 64): (0.22355, 2.65490, 58239.8),
}
"""Table 4.5: depth and irradiance resolution -> mean and maximum error, memory in KiB. The row 16, 8 is printed twice,
the second time with a mean of 0.22225."""

TIMES_OVER_RAYS = {
    8: (0.60, 0.01, 0.10, 0.13, 0.30, 1.14),
    16: (0.84, 0.09, 0.05, 0.09, 0.37, 1.44),
    32: (1.50, 0.04, 0.10, 0.08, 0.41, 2.13),
    64: (2.71, 0.02, 0.05, 0.10, 0.48, 3.36),
    128: (5.15, 0.25, 0.03, 0.10, 0.41, 5.94),
    256: (9.56, 0.79, 0.09, 0.11, 0.48, 11.01),
}
"""Table 4.6: rays a probe -> ms of tracing, integration, dead probe detection, probe offset, shading, and in all."""

TIMES_OVER_DEPTH = {
    2: (2.5, 0.08, 0.20, 0.10, 0.25, 3.14),
    4: (2.5, 0.15, 0.23, 0.09, 0.23, 3.20),
    8: (2.5, 0.25, 0.10, 0.11, 0.24, 3.20),
    16: (2.5, 0.37, 0.05, 0.21, 0.22, 3.35),
    32: (2.5, 1.12, 0.05, 0.27, 0.23, 4.17),
    64: (2.5, 4.03, 0.05, 0.07, 0.35, 7.00),
}
"""Table 4.7: depth resolution -> the same stages."""

STABILITY = {
    (8, False): (22647, 0.0109, 0.1796),
    (16, False): (16175, 0.0078, 0.2591),
    (32, False): (11443, 0.0055, 0.2827),
    (64, False): (7876, 0.0038, 0.2072),
    (128, False): (5420, 0.0026, 0.1339),
    (256, False): (3843, 0.0019, 0.0999),
    (8, True): (22996, 0.0111, 0.2151),
    (16, True): (15950, 0.0077, 0.1381),
    (32, True): (11411, 0.0055, 0.1314),
}
"""Figure 4.8: rays a probe, with offsets or without -> change between frames summed over the image, mean, maximum."""

# ---------- Ekberg 2022 ----------

TIMES_STILL = {
    ("ddgi", 50): (2.4, 1.75, 0.25, 4.4),
    ("gibs", 2): (0.32, 4.28, 0.25, 4.85),
    ("ddgi", 100): (4.45, 1.75, 0.24, 6.44),
    ("gibs", 4): (0.58, 4.46, 0.25, 5.29),
}
"""Overview, camera not yet moved: method and rays an item -> ms of ray casting, application, the rest, and in all."""

TIMES_FLOWN = {("gibs", 4): (3.1, 12.2, 0.25, 15.55)}
"""The same after a flight around the whole scene."""

EKBERG_RAYS = {50_000: (1, 25), 100_000: (2, 50), 200_000: (4, 100)}
"""Rays a frame -> rays a surfel (50,000 surfels), rays a probe (20x10x10 probes)."""
