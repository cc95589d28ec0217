"""The scene with its own materials: the same picture where all is diffuse, another one where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from luxel import runtime
from luxel.kernels.camera import camera_axes
from luxel.render.oracle import make_full_scene, render_full
from luxel.scene import load
from luxel.scene.edit import default_camera
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

SIZE = (24, 24)


@pytest.fixture(autouse=True)
def started() -> None:
    runtime.start()


def make_floor(material: Material, **extra: object) -> SceneData:
    """A square of 4 m at y = 0, seen from above: image right is +X, image up is -Z; (u, v) run along +X and +Z."""
    positions = np.array([[-2, 0, -2], [-2, 0, 2], [2, 0, 2], [2, 0, -2]], np.float32)
    uv = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    camera = Camera((0, 4, 0), (0, 0, 0), (0, 0, -1), 50.0)
    scene = SceneData("floor", [Object("floor", [Mesh(positions, faces, uv=uv)])], [material], cameras=[camera])
    for name, value in extra.items():
        setattr(scene, name, value)
    return scene


def render(scene: SceneData, spp: int = 4) -> np.ndarray:
    return render_full(scene, scene.cameras[0], size=SIZE, spp=spp)


SUN = [Light("directional", (np.pi, np.pi, np.pi), direction=(0.0, -1.0, 0.0))]


def test_a_scene_without_gloss_is_the_diffuse_one() -> None:
    from luxel.render.renderer import Renderer

    data = load("two-rooms")
    image = render_full(data, default_camera(data), size=(32, 32), spp=96)
    renderer = Renderer(data, "path", size=(32, 32))
    renderer.run(96)
    ours = renderer.image()
    assert image.shape == ours.shape and image.dtype == np.float32
    seen = ours.max(axis=-1) < 5.0
    assert image[seen].mean() == pytest.approx(ours[seen].mean(), rel=0.03)
    assert np.corrcoef(image[seen].ravel(), ours[seen].ravel())[0, 1] > 0.97


def test_directional_light_and_base_colour() -> None:
    image = render(make_floor(Material(base_color=(0.2, 0.4, 0.6)), lights=SUN))
    assert image[12, 12] == pytest.approx([0.2, 0.4, 0.6], rel=1e-3)
    none = render(make_floor(Material(base_color=(0.2, 0.4, 0.6))))
    assert none.max() == 0.0


def test_wide_suns_shine_as_much_as_sharp_ones() -> None:
    """On a plane that faces the sun; the sky behind the disc shows through it."""
    wide = [Light("directional", (np.pi, np.pi, np.pi), direction=(0.0, -1.0, 0.0), angular_diameter=30.0)]
    image = render(make_floor(Material(base_color=(0.2, 0.4, 0.6)), lights=wide), spp=16)
    assert image[8:16, 8:16].mean(axis=(0, 1)) == pytest.approx([0.2, 0.4, 0.6], rel=1e-2)
    up = make_floor(Material(), lights=wide, sky=Sky((0.5, 0.5, 0.5)))
    up.cameras = [Camera((0, 1, 0), (0, 5, 0), (0, 0, -1), 50.0)]
    seen = render(up)
    radiance = 1.0 / np.sin(np.radians(15.0)) ** 2
    assert seen[12, 12] == pytest.approx(np.full(3, 0.5 + radiance), rel=1e-3)
    assert seen[1, 1] == pytest.approx(np.full(3, 0.5), rel=1e-3)


def test_textures_lie_as_gltf_says() -> None:
    # Row 0 is v = 0, which the floor has at -Z: the upper edge of the image.
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, :, 0] = 255
    pixels[:, 1, 2] = 255
    texture = Texture(pixels, srgb=False, nearest=True)
    image = render(make_floor(Material(base_color=(1, 1, 1), base_color_texture=texture), lights=SUN))
    upper_left, upper_right = image[4, 4], image[4, 19]
    lower_left, lower_right = image[19, 4], image[19, 19]
    assert upper_left[0] > 5 * upper_left[2] and lower_right[2] > 5 * lower_right[0]
    assert min(upper_right[0], upper_right[2]) > 0.5 and lower_left.max() < 0.2


def test_metals_are_not_what_diffuse_albedo_shows() -> None:
    sky = Sky((1.0, 1.0, 1.0))
    metal = render(make_floor(Material(base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.1), sky=sky), spp=16)
    assert metal[12, 12].mean() == pytest.approx(0.9, rel=0.1)


def test_cut_outs_are_holes() -> None:
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0, :, 3] = 0
    material = Material(base_color=(1, 1, 1), base_color_texture=Texture(pixels, nearest=True), alpha_mode="mask")
    image = render(make_floor(material, lights=SUN))
    assert image[4, 12].max() == 0.0 and image[19, 12].min() > 0.5


def test_blended_lamps_shine_by_their_alpha() -> None:
    glow = Material(base_color=(0, 0, 0), emission=(1.0, 0.5, 0.25), alpha=0.4, alpha_mode="blend")
    # Mitsuba takes a ray that leaves an empty scene through a mask for none at all: a faint sky is behind it.
    sky = Sky((1e-6, 1e-6, 1e-6))
    assert render(make_floor(glow, sky=sky), spp=16)[12, 12] == pytest.approx([0.4, 0.2, 0.1], rel=1e-3)
    holes = np.zeros((4, 4, 4), np.uint8)
    holes[:, 2:] = 255
    cut = Material(base_color_texture=Texture(holes), emission=(1.0, 0.5, 0.25), alpha_mode="mask")
    image = render(make_floor(cut, sky=sky), spp=16)
    assert image[12, 6].max() < 1e-4 and image[12, 18] == pytest.approx([1.0, 0.5, 0.25], rel=1e-3)


def test_emission_shines_from_the_front() -> None:
    scene = make_floor(Material(base_color=(0, 0, 0), emission=(3.0, 2.0, 1.0)))
    assert render(scene)[12, 12] == pytest.approx([3.0, 2.0, 1.0])
    scene.cameras = [Camera((0, -4, 0), (0, 0, 0), (0, 0, -1), 50.0)]
    assert render(scene).max() == 0.0


@pytest.mark.parametrize("rotation", [0.0, 90.0, 200.0])
def test_the_sky_lies_as_ours_does(rotation: float) -> None:
    from luxel.render.renderer import Renderer

    image = np.zeros((16, 32, 3), np.float32)
    image[6:10, 16:24, 0] = 1.0
    image[6:10, :8, 1] = 1.0
    scene = make_floor(Material(), sky=Sky((1.0, 1.0, 1.0), image, rotation))
    for target in ((0, 1, -1), (1, 1, 0), (0, 1, 1), (-1, 1, 0)):
        scene.cameras = [Camera((0, 1, 0), target, fov=90.0)]
        renderer = Renderer(scene, "none", size=SIZE)
        renderer.step()
        assert camera_axes(scene.cameras[0])[3] == pytest.approx(np.subtract(target, (0, 1, 0)))
        # Above the horizon, where the floor is out of sight; Mitsuba puts rows half a pixel further out.
        np.testing.assert_allclose(render(scene, 1)[:10], renderer.image()[:10], atol=0.2)


def test_point_and_spot_light_the_floor_below_them() -> None:
    point = Light("point", (4.0, 4.0, 4.0), position=(0.0, 1.0, 0.0))
    spot = Light("spot", (4.0, 4.0, 4.0), (0.0, 1.0, 0.0), cos_inner=np.cos(0.2), cos_outer=np.cos(0.3))
    material = Material(base_color=(0.5, 0.5, 0.5))
    wide, narrow = (render(make_floor(material, lights=[light])) for light in (point, spot))
    assert narrow[12, 12] == pytest.approx(wide[12, 12], rel=0.05)
    assert wide[2, 2].min() > 0.0 and narrow[2, 2].max() == 0.0


def test_moved_and_mirrored_objects() -> None:
    material = Material(base_color=(0.5, 0.5, 0.5), reflect_back=False)
    scene = make_floor(material, lights=SUN)
    scene.objects[0].to_world = np.diag([-0.25, 1.0, 0.25, 1.0])
    image = render(scene)
    assert image[12, 12].min() > 0.3 and image[4, 4].max() == 0.0
    assert isinstance(make_full_scene(scene).bbox().max.x, float)
