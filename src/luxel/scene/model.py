"""The scene as plain data: NumPy arrays and Python numbers, no Mitsuba.

Loaders and built-in scenes produce a `SceneData`; `luxel.scene.device` turns it into what the kernels read.
Units are metres, watts and seconds; colours are linear Rec. 709; +Y is up; matrices act on column vectors.
A value that cannot be (an albedo of 2, a light of kind 'area') raises LuxelError when it is set, by `rules.py`;
`check.py` looks at what takes more than one record, such as indices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from luxel.scene.records import Record

Colour = tuple[float, float, float]


@dataclass
class Texture(Record):
    """One image and how a material reads it.

    `image` is (H, W, C) with C in 1, 3, 4: uint8, or float32 in 0..1. Row 0 is v = 0 (the glTF convention).
    """

    image: np.ndarray
    srgb: bool = True
    """True for colours stored with the sRGB curve; False for data (normals, roughness) and linear colours."""
    wrap_u: Literal["repeat", "clamp", "mirror"] = "repeat"
    wrap_v: Literal["repeat", "clamp", "mirror"] = "repeat"
    nearest: bool = False
    uv_set: int = 0
    """0 reads `Mesh.uv`, 1 reads `Mesh.uv2`."""
    transform: np.ndarray = field(default_factory=lambda: np.eye(3, dtype=np.float32))
    """(3, 3): uv' = transform @ (u, v, 1)."""


@dataclass
class Material(Record):
    """Metal-rough surface with a dielectric coat, a clear coat and glass, by the names of glTF and Mitsuba.

    A factor multiplies its texture; a missing texture reads as one. Under the diffuse condition only the albedo
    base_color x (1 - metallic) and alpha count (`diffuse.py` says how the rest is brought to that).
    """

    name: str = ""
    base_color: Colour = (0.8, 0.8, 0.8)
    base_color_texture: Texture | None = None
    """Its alpha (if it has one) multiplies `alpha`."""
    metallic: float = 0.0
    roughness: float = 1.0
    """Perceptual: the microfacets' alpha is its square. 0: a mirror."""
    metallic_roughness_texture: Texture | None = None
    """glTF channels: green = roughness, blue = metallic."""
    emission: Colour = (0.0, 0.0, 0.0)
    """Radiance, W/(m^2 sr), of the emitting side."""
    emission_texture: Texture | None = None
    normal_texture: Texture | None = None
    normal_scale: float = 1.0
    alpha: float = 1.0
    alpha_mode: Literal["opaque", "mask", "blend"] = "opaque"
    """opaque: alpha is not read. mask: rays pass where alpha < `alpha_cutoff`. blend: a ray passes with probability
    1 - alpha (glTF's BLEND, Mitsuba's `mask`)."""
    alpha_cutoff: float = 0.5
    reflect_back: bool = True
    """False: the back side absorbs everything (Mitsuba's one-sided BSDFs). True: both sides reflect."""
    emit_back: bool = False
    """True: the back side emits too."""
    emission_uses_colors: bool = False
    """True: `Mesh.colors` multiply the emission too (unlit materials)."""
    ior: float = 1.5
    """Index of refraction of what is under the surface, over that outside it. Below 1 glass is thinner inside, as a
    bubble is in water; a coat reflects as one of 1 / `ior`, a plastic's as one of 1. 0: the coat reflects
    `specular_color` at normal incidence, as an endless index would (KHR_materials_ior)."""
    specular: float = 0.0
    """Weight of the dielectric coat's reflection; 0: there is none."""
    specular_texture: Texture | None = None
    """Alpha."""
    specular_color: Colour = (1.0, 1.0, 1.0)
    """Multiplies what the coat or glass reflects at normal incidence (plastic, and metals by `eta` and `k`: at every
    angle); may be above one."""
    specular_color_texture: Texture | None = None
    transmission: float = 0.0
    """Share of what is no metal that is glass: light enters it, tinted by `base_color`, instead of being scattered."""
    transmission_texture: Texture | None = None
    """Red."""
    thin: bool = False
    """True: glass is a pane, which does not bend light. False: the surface bounds a solid."""
    attenuation_color: Colour = (1.0, 1.0, 1.0)
    """What is left of white light inside glass after `attenuation_distance`."""
    attenuation_distance: float = float("inf")
    """Metres; inf: clear."""
    clearcoat: float = 0.0
    """Weight of a second coat over all, with the index 1.5."""
    clearcoat_texture: Texture | None = None
    """Red."""
    clearcoat_roughness: float = 0.0
    clearcoat_roughness_texture: Texture | None = None
    """Green."""
    eta: Colour | None = None
    """A metal's complex index eta + i k by channel, over that outside; None: it reflects `base_color` (Schlick)."""
    k: Colour | None = None
    """None beside `eta`: zero. Without `eta` it has no meaning, and is refused."""
    distribution: Literal["ggx", "beckmann"] = "ggx"
    """Of the microfacets' normals."""
    compensate: bool = False
    """True: light that is scattered between microfacets is added (Kulla and Conty), so that rough metals are not dark;
    glTF's way. Mitsuba's materials lose it."""
    interface: Literal["gltf", "plastic", "principled"] = "gltf"
    """How light gets through the coat to what scatters it. gltf: what the coat does not reflect. plastic: as Mitsuba's
    plastics and dielectrics have it, where it passes the interface twice and is reflected inside of it. principled: all
    light does, whatever the coat reflects (Burley)."""
    nonlinear: bool = False
    """plastic: each reflection inside takes the colour on once more."""
    diffuse: Material | None = None
    """Colour, alpha, sides (`diffuse.SHOWN`), and emission if it has any, under the diffuse condition, where a reader
    knows them better than the fields tell; None: as they tell. Assigning a field and `set_material` forget it."""

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        # In the constructor `diffuse` comes last.
        if name != "diffuse" and self.__dict__.get("diffuse") is not None:
            self.__dict__["diffuse"] = None


@dataclass
class Mesh(Record):
    """Triangles of one material, in object space. Counter-clockwise from the front."""

    positions: np.ndarray
    """(V, 3) float32."""
    faces: np.ndarray
    """(F, 3) uint32."""
    material: int = 0
    """Index into `SceneData.materials`."""
    normals: np.ndarray | None = None
    """(V, 3) float32 or None: flat shading."""
    uv: np.ndarray | None = None
    """(V, 2) float32."""
    uv2: np.ndarray | None = None
    """(V, 2) float32: the light map's coordinates."""
    colors: np.ndarray | None = None
    """(V, 3) or (V, 4) float32, linear; multiplies the base colour (and alpha)."""
    uv2_set: int = 1
    """What number the file gives `uv2`: 1, unless a texture reads a higher set."""
    uv_more: dict[int, np.ndarray] = field(default_factory=dict)
    """The file's other sets, (V, 2) float32 by their numbers: no texture reads them, but who writes the file again."""


@dataclass
class Object(Record):
    """What moves as one. Its meshes share one transform; a deforming object answers vertices for a time instead."""

    name: str
    meshes: list[Mesh]
    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float64, at time 0."""
    motion: Callable[[float], np.ndarray] | None = None
    """time in seconds -> (4, 4) object-to-world; None: it stands still."""
    deform: Callable[[float], list[tuple[np.ndarray, np.ndarray | None]]] | None = None
    """time -> for each mesh ((V, 3) positions, (V, 3) normals or None), in object space; None: rigid."""
    node: int | None = None
    """Index into `SceneData.nodes` of the node that it hangs on; None: the file has no tree."""


@dataclass
class Node(Record):
    """A node of the file's tree, for who writes the file again. `Object.to_world` holds all that rendering needs."""

    name: str | None
    parent: int | None
    """Index into `SceneData.nodes`; None: a root."""
    transform: dict[str, list[float]]
    """glTF's `matrix`, or `translation`, `rotation` and `scale`, as the file has them."""
    world: np.ndarray
    """(4, 4) float64 node-to-world, at time 0."""


@dataclass
class Light(Record):
    """A light without a surface. Emissive triangles are materials, not lights."""

    kind: Literal["directional", "point", "spot"]
    color: Colour
    """directional: irradiance on a facing plane, W/m^2; point and spot: radiant intensity on the axis, W/sr."""
    position: Colour = (0.0, 0.0, 0.0)
    direction: Colour = (0.0, -1.0, 0.0)
    """The way the light travels; need not be normalised."""
    cos_inner: float = 1.0
    cos_outer: float = 0.7071068
    """spot: the light falls off between the two half-angle cosines."""
    spot_falloff: Literal["squared-cosine", "linear-angle"] = "squared-cosine"
    """squared-cosine: the square of a ramp over the cosine (KHR_lights_punctual). linear-angle: a ramp over the angle
    (Mitsuba's `spot`)."""
    range: float = float("inf")
    """point and spot: beyond it no light (KHR_lights_punctual window)."""
    name: str = ""
    motion: Callable[[float], np.ndarray] | None = None
    """time -> (4, 4) applied to position and direction; None: it stands still."""
    angular_diameter: float = 0.0
    """directional: degrees that the sun's disc, of one radiance all over, is wide; 0: one direction, sharp shadows."""
    in_sky: bool = False
    """directional: it is part of the sky, as the suns of sky images are: camera rays that miss see its disc, another
    sky takes it away, and `--sun` leaves it."""


@dataclass
class Camera(Record):
    """A pinhole, or an orthographic camera. Images have row 0 at the top."""

    eye: Colour = (0.0, 0.0, 5.0)
    target: Colour = (0.0, 0.0, 0.0)
    up: Colour = (0.0, 1.0, 0.0)
    fov: float = 60.0
    """Horizontal field of view in degrees. Mitsuba's and glTF's other axes are converted by the loaders
    for the file's own aspect; square where the file has none."""
    orthographic_width: float = 0.0
    """Metres across the image of an orthographic camera, whose rays are parallel; 0: perspective, by `fov`."""
    orthographic_height: float = 0.0
    """Metres up the image of an orthographic camera that stretches it; 0: as the image's shape gives it."""
    mirrored: bool = False
    """The image is turned left to right."""
    lens_shift: tuple[float, float] = (0.0, 0.0)
    """Which point of the unshifted image, x to the right and y up from -1 to 1, is the image's middle: a principal
    point off the centre, or a crop window."""
    name: str = "default"
    motion: Callable[[float], np.ndarray] | None = None
    """time -> (4, 4) camera-to-world (looks along -Z, +Y up), which replaces eye, target and up."""


@dataclass
class Sky(Record):
    """Light from infinitely far away, without the suns' discs: indirect light by luxel's rule."""

    color: Colour = (0.0, 0.0, 0.0)
    """Radiance; multiplies the image where there is one."""
    image: np.ndarray | None = None
    """(H, W, 3) float32 latitude-longitude radiance; row 0 is the zenith (+Y)."""
    rotation: float = 0.0
    """Degrees; positive turns the image from -Z towards +X. At 0 the image's centre column looks along -Z, its left
    edge along +Z, and columns to the right of the centre turn towards +X."""
    suns: list[Light] | None = None
    """What was cut out of the image and shines as lights (`Light.in_sky`), as it is at rotation 0 under colour 1.
    None: suns have not been looked for, which happens when the scene is loaded or rendered."""


@dataclass
class SceneData(Record):
    """Everything a loader knows about a scene."""

    name: str
    objects: list[Object]
    materials: list[Material]
    lights: list[Light] = field(default_factory=list)
    cameras: list[Camera] = field(default_factory=list)
    sky: Sky = field(default_factory=Sky)
    hide_emitters: bool = False
    """True: camera rays pass through surfaces that emit and see no sky; both still light (Mitsuba's name)."""
    flight: list[Camera] = field(default_factory=list)
    """Key views of a camera path that sees every surface; consumers interpolate between them."""
    nodes: list[Node] = field(default_factory=list)
    """The file's node tree, where it has one."""
    origin: Colour = (0.0, 0.0, 0.0)
    """The point, in the file's coordinates as everything here, that the device measures from (`local.py`). The loaders
    choose one amid a scene that lies far from (0, 0, 0)."""
    duration: float = 0.0
    """Seconds that its animations last; 0: nothing moves."""
    default_sun: Light | None = None
    """The sun among `lights` that luxel added where the file has no light of its own; another sky takes it away."""
    warnings: list[str] = field(default_factory=list)
    """What the file holds that luxel does not do: one sentence each, each said once."""
    diffuse_warnings: list[str] = field(default_factory=list)
    """Those of `warnings` that hold under the diffuse condition alone: full materials do what they say is not done."""
    facts: dict[str, float] = field(default_factory=dict)
    """Known truths of built-in scenes, such as {"radiance": 2.0}; used by tests."""
    mitsuba_full: Callable[[], object] | None = None
    """-> a `mi.Scene` with the file's own materials, measured from `origin`, for `render/oracle.py`; None: made from
    `materials`."""
