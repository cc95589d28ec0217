"""The record that the lobes share: a BSDF as seen along `wo`."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from luxel.kernels.bsdf.record import BSDF, BSDFFeatures

LEAST = 1e-4
"""Smallest divisor of quotients whose numerators vanish with it."""


@dataclass
class View:
    """A BSDF as seen along `wo`, in a frame that has `wo` above; what does not depend on `wi`, computed once."""

    features: BSDFFeatures
    bsdf: BSDF
    base_color: mi.Color3f
    outside: mi.Bool
    """True where `wo` is on the front side."""
    flip: mi.Bool
    """True where the frame was mirrored."""
    wo: mi.Vector3f
    # From here on only with `features.gloss`.
    metal: mi.Float = 0.0
    opaque: mi.Float = 1.0
    clear: mi.Float = 0.0
    """Weights of metal, opaque dielectric and clear dielectric."""
    eta: mi.Float = 1.0
    """Index on the other side over that on the side of `wo`."""
    f0: mi.Float = 0.0
    """Reflectance of the dielectric at normal incidence."""
    f0_color: mi.Color3f = 0.0
    """The same with the specular colour, without the weight."""
    alpha: mi.Float = 1.0
    roughness: mi.Float = 1.0
    """sqrt(alpha), 0 for delta lobes: the tables' axis."""
    rough: mi.Bool = True
    rough_through: mi.Bool = True
    """False where what passes is delta."""
    matched: mi.Bool = False
    thin: mi.Bool = False
    beckmann: mi.Bool = False
    plastic: mi.Bool = False
    compensate: mi.Bool = False
    narrowing: mi.Float = 1.0
    """Factor of radiance that comes through."""
    dense: mi.Float = 1.0
    """Plastic: index of the base under the interface, 1 or more."""
    transmittance: mi.Float = 1.0
    """Plastic: what the interface lets in along `wo`."""
    mean_transmittance: mi.Float = 1.0
    """Plastic: the mean of that over the hemisphere, weighted by the cosine."""
    leaving: mi.Color3f = 1.0
    """Plastic: what leaves along `wo` of light that the base has reflected once, and what it throws back and reflects
    again."""
    white: mi.Float = 1.0
    """Albedo of facets of reflectance 1 along `wo`, and its mean."""
    mean_white: mi.Float = 1.0
    several_metal: mi.Color3f = 0.0
    several_dielectric: mi.Color3f = 0.0
    """Reflectance of light that meets more than one facet."""
    rise: mi.Float = 2.0
    """Its directions are drawn with a density of rise z^(rise - 1) over the cosine z."""
    base_coat: mi.Float = 0.0
    """Albedo of the dielectric's reflection along `wo`, largest channel, and its mean."""
    mean_base_coat: mi.Float = 0.0
    clearcoat: mi.Float = 0.0
    coat_alpha: mi.Float = 1.0
    coat_roughness: mi.Float = 0.0
    coat_rough: mi.Bool = True
    coat: mi.Float = 0.0
    """What the clear coat reflects along `wo`, and its mean."""
    mean_coat: mi.Float = 0.0
    p_base: mi.Float = 1.0
    """Probabilities of drawing from the cosine's lobe, several facets' lobe, one facet, the clear coat."""
    p_several: mi.Float = 0.0
    p_facet: mi.Float = 0.0
    p_coat: mi.Float = 0.0
