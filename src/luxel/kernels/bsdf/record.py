"""What a surface does with light at a point, and what drawing from it gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mitsuba as mi

from luxel.kernels.bsdf.tables import BSDFTables

ALPHA_FLOOR = 1e-3
"""A lobe whose alpha is smaller reflects like a mirror (a delta lobe)."""

COAT_F0 = 0.04
"""Reflectance of a clear coat at normal incidence: an index of 1.5."""

LOBE_NONE, LOBE_DIFFUSE, LOBE_REFLECTION, LOBE_TRANSMISSION, LOBE_COAT = range(5)
"""Which lobe a direction was drawn from; none where nothing reflects."""


class BSDFFeatures(NamedTuple):
    """What any surface of the scene may have: Python bools, so that the rest is left out of the kernel.

    Where one is False the fields it names are not read.
    """

    gloss: bool = False
    """All but Lambert's law with `base_color`; the others need it."""
    specular: bool = False
    """An opaque dielectric with `specular` above 0 that is not `plastic`."""
    beckmann: bool = False
    conductor: bool = False
    """`eta`, `k` and `has_eta`."""
    plastic: bool = False
    """`plastic` and `nonlinear`."""
    transmission: bool = False
    """`transmission` and `thin`."""
    clearcoat: bool = False
    """`clearcoat` and `clearcoat_alpha`."""
    compensate: bool = False


@dataclass
class BSDF:
    """Parameters at a point, arrays of equal width or Python numbers; weights and colours 0..1.

    The material is a mixture by `metallic` of a metal and a dielectric; the dielectric by `transmission` of a diffuse
    base and a clear one, both under the same interface; and a clear coat over all. Frames have the front side at z > 0.
    A dielectric that transmits has its inside at z < 0; everything else is black from there.
    """

    base_color: mi.Color3f
    """Diffuse reflectance of the base, tint of what is transmitted, F0 of a metal without `eta` and `k`."""
    features: BSDFFeatures = BSDFFeatures()
    tables: BSDFTables | None = None
    """Needed by the features `specular`, `plastic`, `clearcoat` and `compensate`."""
    metallic: mi.Float = 0.0
    alpha: mi.Float = 1.0
    """Width of the microfacets' distribution, the square of the roughness; below `ALPHA_FLOOR` the lobe is delta."""
    beckmann: mi.Bool = False
    """Beckmann's distribution where true, else GGX."""
    has_eta: mi.Bool = False
    """True where the metal has `eta` and `k`, its relative complex index per channel."""
    eta: mi.Color3f = 1.0
    k: mi.Color3f = 0.0
    ior: mi.Float = 1.5
    """Index behind the surface over the index before it."""
    specular: mi.Float = 0.0
    """Weight of the dielectric interface's reflection."""
    specular_color: mi.Color3f = 1.0
    """Factor of its reflectance at normal incidence; for `plastic`, and a metal's by `eta` and `k`, at every angle."""
    transmission: mi.Float = 0.0
    thin: mi.Bool = False
    """A pane: light passes without refraction, and is reflected on both of its faces."""
    clearcoat: mi.Float = 0.0
    clearcoat_alpha: mi.Float = 0.0
    """Width of the clear coat's GGX distribution, below `ALPHA_FLOOR` delta."""
    plastic: mi.Bool = False
    """The interface as Mitsuba's plastics and dielectrics have it, else glTF's."""
    added: mi.Bool = False
    """The base scatters all light, whatever the interface reflects, as Burley's principled BSDF has it."""
    nonlinear: mi.Bool = False
    """Plastic: light that the interface throws back to the base takes its colour each time."""
    compensate: mi.Bool = False
    """Give back what single scattering loses between rough facets (Kulla and Conty 2017)."""


@dataclass
class BSDFValue:
    """BSDF times the cosine of `wi`, per steradian."""

    diffuse: mi.Color3f
    """Light that the base scatters. Under an interface it depends on both directions, not on the cosine of `wi` alone;
    `diffuse_albedo` is what it comes to in even light."""
    glossy: mi.Color3f
    """All else: reflections, several bounces between facets, what is let through."""

    @property
    def total(self) -> mi.Color3f:
        return self.diffuse + self.glossy


@dataclass
class BSDFSample:
    """A direction, and the factors of the radiance that arrives along it."""

    wi: mi.Vector3f
    """Unit, towards the light."""
    diffuse: mi.Color3f
    """The diffuse part of BSDF times cosine over the density."""
    glossy: mi.Color3f
    """The same of the glossy part; the whole of a delta lobe."""
    density: mi.Float
    """Per steradian over all lobes that are not delta; for a delta lobe the probability of having been drawn."""
    delta: mi.Bool
    transmitted: mi.Bool
    """True where `wi` is on the other side than `wo`."""
    lobe: mi.UInt32
    """`LOBE_NONE` (nothing was drawn: weight and density are 0) to `LOBE_COAT`."""

    @property
    def weight(self) -> mi.Color3f:
        """BSDF times cosine over density, of all parts."""
        return self.diffuse + self.glossy
