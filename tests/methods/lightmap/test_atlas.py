"""The atlas: charts on texel centres, apart from one another, every texel that a look-up reads filled."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.bake import bake_scene
from luxel.methods.lightmap.flatten.atlas import find_texels, make_atlas, pack, spread_points
from luxel.methods.lightmap.flatten.faces import find_faces, find_parts, still_scene
from luxel.methods.lightmap.flatten.flat_scene import lay_out
from luxel.methods.lightmap.flatten.pieces import find_pieces
from luxel.methods.lightmap.flatten.raster import cover
from luxel.methods.lightmap.flatten.unwrap import CHART_FACES, find_fault, unwrap
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import sphere
from luxel.scene.model import Material, Mesh, Object, SceneData, Sky

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
TWO = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def laid_out(name: str, texels: int = 2048):
    scene = upload(load(name))
    faces = find_faces(scene, still_scene(scene))
    atlas = make_atlas(faces, unwrap(faces, name), texels, 0.0, name)
    return faces, atlas, spread_points(faces, atlas)


@pytest.mark.parametrize("seed", range(3))
def test_packed_rectangles_stand_a_texel_apart(seed: int) -> None:
    sizes = np.random.default_rng(seed).integers(1, 40, (60, 2))
    place, width, height = pack(sizes)
    taken = np.zeros((height + 1, width + 1), int)
    for (x, y), (wide, high) in zip(place, sizes, strict=True):
        assert x + wide <= width and y + high <= height
        # A rectangle and the texel beyond its right and upper side: none may be another's.
        taken[y : y + high + 1, x : x + wide + 1] += 1
    assert taken.max() == 1
    assert sizes.prod(axis=1).sum() > 0.6 * width * height


def test_straight_borders_run_through_texel_centres() -> None:
    faces, atlas, _ = laid_out("two-rooms")
    assert (atlas.chart >= 0).all()
    wide = [index for index in range(atlas.chart_count) if faces.area[atlas.chart == index].sum() > 1.0]
    for index in wide:
        uv = atlas.uv[atlas.chart == index].reshape(-1, 2)
        ends = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
        np.testing.assert_allclose(ends, np.round(ends), atol=1e-5)


@pytest.mark.parametrize("name", ["cornell-box", "attic", "sphere"])
def test_look_ups_read_texels_of_their_own_chart(name: str) -> None:
    faces, atlas, points = laid_out(name)
    everything = np.ones(len(points.p), bool)
    texels, fine = find_texels(atlas, points, everything, points.chart, everything)
    assert fine.all() and (np.diff(texels.starts) >= 1).all()
    assert len(np.unique(texels.slot)) == len(texels.slot)
    # Each texel samples its own chart alone, from no farther than its neighbours.
    row = np.repeat(np.arange(len(texels.slot)), np.diff(texels.starts))
    assert (points.chart[texels.points] == texels.chart[row]).all()
    middle = np.stack([texels.slot % atlas.width, texels.slot // atlas.width], axis=1)
    assert np.abs(points.xy[texels.points] - middle[row]).max() <= 1.5
    # And whatever four texels stand around a point of a chart, they are there.
    held = np.isin(np.arange(atlas.width * atlas.height), texels.slot)
    at = (points.weights[..., None] * atlas.uv[points.face]).sum(axis=1)
    low, high = np.floor(at + 1e-6).astype(int), np.ceil(at - 1e-6).astype(int)
    for x, y in ((low, low), (high, low), (low, high), (high, high)):
        assert held[y[:, 1] * atlas.width + x[:, 0]].all()
    assert points.area.sum() == pytest.approx(faces.area.sum())
    assert (np.bincount(points.chart, minlength=atlas.chart_count) > 0).all()


def test_the_number_of_texels_follows_the_target() -> None:
    for target in (1000, 8000):
        _, atlas, points = laid_out("cornell-box", target)
        everything = np.ones(len(points.p), bool)
        count = len(find_texels(atlas, points, everything, points.chart, everything)[0].slot)
        assert 0.7 * target < count < 1.3 * target


def test_a_gap_in_what_is_valid_is_reported() -> None:
    _, atlas, points = laid_out("cornell-box")
    valid = points.chart != 0
    texels, fine = find_texels(atlas, points, valid, points.chart, valid)
    assert not fine[texels.chart == 0].any() and fine[texels.chart != 0].all()


def shards(count: int) -> SceneData:
    """A floor, and small triangles that hang above it, apart from one another."""
    random = np.random.default_rng(5)
    p = random.random((count, 1, 3)) * [3.0, 2.0, 3.0] + [0.0, 0.5, 0.0] + 0.02 * random.random((count, 3, 3))
    floor = np.array([[0, 0, 0], [0, 0, 3], [3, 0, 3], [3, 0, 0]], np.float32)
    small = Mesh(p.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3), 0)
    return SceneData("shards", [Object("floor", [Mesh(floor, TWO, 0)]), Object("shards", [small])], [Material()])


def test_charts_smaller_than_a_texel_take_one_and_are_sampled_all_over() -> None:
    scene = upload(shards(200))
    flat = lay_out(scene, LightmapParams(texel_target=2000), 0)
    assert not flat.notes
    assert 0.7 * 2000 < len(flat.texels.slot) < 1.3 * 2000
    chart_count = flat.atlas.chart_count
    texels = np.bincount(flat.texels.chart, minlength=chart_count)
    points = np.bincount(flat.points.chart, minlength=chart_count)
    tiny = flat.atlas.narrow.all(axis=1)
    assert tiny.sum() > 150
    assert (texels[tiny] == 1).all()
    # Half of its square, about, and nowhere but on it.
    assert (points[tiny] >= 4).all() and points[tiny].mean() > 6.0
    assert np.abs(flat.points.weights.sum(axis=1) - 1.0).max() < 1e-6 and flat.points.weights.min() > -1e-5


def test_too_few_texels_for_the_charts_are_raised_and_said() -> None:
    flat = lay_out(upload(shards(200)), LightmapParams(texel_target=100), 0)
    assert "'texel_target' 100 is too little for" in flat.notes[0]
    assert len(flat.texels.slot) >= flat.atlas.chart_count
    floor = flat.faces.unit // 2 == 1
    assert (np.isin(flat.texels.chart, flat.atlas.chart[floor])).sum() > 100


def test_a_surface_of_many_faces_is_cut_into_charts_of_some_size() -> None:
    side = np.linspace(-1.0, 1.0, 80)
    x, z = (grid.ravel() for grid in np.meshgrid(side, side))
    p = np.stack([x, 0.5 * (x * x + z * z), z], axis=1).astype(np.float32)
    corner = (np.arange(79)[:, None] * 80 + np.arange(79)).ravel()
    quads = np.stack([corner, corner + 80, corner + 81, corner, corner + 81, corner + 1], axis=1).reshape(-1, 3)
    scene = upload(SceneData("bowl", [Object("bowl", [Mesh(p, quads.astype(np.uint32), 0)])], [Material()]))
    told: list[float] = []
    faces = find_faces(scene, still_scene(scene))
    charts = unwrap(faces, "bowl", lambda text, share: told.append(share))
    amount = np.bincount(charts.chart)
    assert (charts.chart >= 0).all() and 1 < charts.count < 60
    assert amount.max() <= 2 * CHART_FACES
    assert told == sorted(told) and told[0] == 0.0 and told[-1] == 1.0


def test_an_atlas_too_small_for_its_charts_is_refused() -> None:
    scene = upload(load("cornell-box"))
    faces = find_faces(scene, still_scene(scene))
    with pytest.raises(LuxelError, match="too small for its charts"):
        make_atlas(faces, unwrap(faces, "cornell-box"), 100, 5000.0, "cornell-box")


def test_more_texels_than_memory_holds_are_refused() -> None:
    with pytest.raises(LuxelError, match="1,000 texels a metre make .* texels, and 16,000,000 are"):
        lay_out(upload(load("cornell-box")), LightmapParams(texels_per_metre=1000.0), 0)


def square_scene(uv2: np.ndarray | None) -> SceneData:
    mesh = Mesh(SQUARE, TWO, 0, uv=SQUARE[:, :2], uv2=uv2)
    return SceneData("square", [Object("square", [mesh])], [Material()])


@pytest.mark.parametrize(
    ("uv2", "complaint"),
    [
        (SQUARE[:, :2] * 0.5, ""),
        (SQUARE[:, :2] * 2.0, "leave the unit square"),
        (np.zeros((4, 2), np.float32), ""),
        (np.array([[0, 0], [1, 0], [1, 1], [0.9, 0.1]], np.float32), "overlap"),
    ],
)
def test_the_files_own_coordinates_serve_where_they_can(uv2: np.ndarray, complaint: str) -> None:
    scene = upload(square_scene(uv2))
    faces = find_faces(scene, still_scene(scene))
    charts = unwrap(faces, "square")
    assert (complaint in " ".join(charts.notes)) if complaint else not charts.notes
    edge_1, edge_2 = charts.uv[:, 1] - charts.uv[:, 0], charts.uv[:, 2] - charts.uv[:, 0]
    flat = 0.5 * np.abs(edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0])
    assert flat[faces.unit == faces.unit[0]].sum() == pytest.approx(1.0, rel=1e-3)
    if complaint:
        assert find_fault(uv2[TWO]) != ""


def two_plates(between: float) -> SceneData:
    """A white plate and a black one, `between` metres apart; in the file's layout they touch."""
    layout = SQUARE[:, :2] * [0.5, 1.0]
    plates = [
        Mesh(2.0 * SQUARE + np.array([x, 0, 0], np.float32), TWO, material, uv2=(layout + [u, 0.0]).astype(np.float32))
        for material, (x, u) in enumerate(((0.0, 0.0), (2.0 + between, 0.5)))
    ]
    materials = [Material("white", (0.9, 0.9, 0.9)), Material("black", (0.05, 0.05, 0.05))]
    return SceneData("plates", [Object("plates", plates)], materials, sky=Sky((1.0, 1.0, 1.0)))


@pytest.mark.parametrize(("between", "count"), [(0.0, 1), (4.0, 2)])
def test_pieces_that_only_touch_in_the_files_layout_are_charts_of_their_own(between: float, count: int) -> None:
    scene = upload(two_plates(between))
    faces = find_faces(scene, still_scene(scene))
    fronts = unwrap(faces, "plates").chart[~faces.back]
    assert len(np.unique(fronts)) == count
    bake = bake_scene(scene, LightmapParams(texel_target=512, surfel_target=64, rays_per_texel=16, probe_target=1), 0)
    # No surfel lies between the plates.
    assert not ((bake.surfel_p[:, 0] > 2.0) & (bake.surfel_p[:, 0] < 2.0 + between)).any()
    assert len(bake.surfel_p) >= 32


def test_neighbours_in_a_chart_that_lie_far_apart_are_two_pieces() -> None:
    """The plates of one chart, as if a slit between them were narrower than the points' grid."""
    scene = upload(two_plates(4.0))
    still = still_scene(scene)
    faces = find_faces(scene, still)
    charts = unwrap(faces, "plates")
    charts.uv[faces.corners[:, :, 0].min(axis=1) > 3.0] += [charts.uv[..., 0].max(), 0.0]
    charts.chart[:], charts.count = faces.back.astype(np.int64), int(faces.back.any()) + 1
    atlas = make_atlas(faces, charts, 1000, 0.0, "plates")
    points = spread_points(faces, atlas)
    everything = np.ones(len(points.p), bool)
    piece = find_pieces(still, atlas, points, faces.normal[points.face], everything)
    far = points.p[:, 0] > 3.0
    assert len(np.unique(piece)) == 2 * charts.count
    assert not set(piece[far]) & set(piece[~far])


def test_triangles_without_area_are_left_out() -> None:
    flat = np.concatenate([SQUARE, [[2, 0, 0], [3, 0, 0], [4, 0, 0]]]).astype(np.float32)
    mesh = Mesh(flat, np.concatenate([TWO, [[4, 5, 6]]]).astype(np.uint32), 0)
    scene = upload(SceneData("flat", [Object("flat", [mesh])], [Material()]))
    assert 2 not in find_faces(scene, still_scene(scene)).prim
    nothing = SceneData("nothing", [Object("flat", [Mesh(flat, np.array([[4, 5, 6]], np.uint32))])], [Material()])
    with pytest.raises(LuxelError, match="has an area"):
        upload(nothing)


def test_a_small_thing_on_a_wide_plain_keeps_its_faces() -> None:
    plain = Mesh(((SQUARE - [0.5, 0.5, 0.0]) * 40_000.0).astype(np.float32)[:, [0, 2, 1]], TWO[:, ::-1].copy(), 0)
    ball = sphere((0.0, 1.0, 0.0), 0.5, 0, rings=48, sectors=96)
    data = SceneData(
        "plain", [Object("plain", [plain]), Object("ball", [ball])], [Material()], sky=Sky((1.0, 1.0, 1.0))
    )
    flat = lay_out(upload(data), LightmapParams(texel_target=2048), 0)
    of_ball = flat.faces.unit // 2 == 2
    assert of_ball.sum() > 0.99 * len(ball.faces) and (flat.atlas.chart[of_ball] >= 0).all()
    assert np.isin(flat.texels.chart, flat.atlas.chart[of_ball]).any()


def test_closed_surfaces_are_told_from_sheets() -> None:
    data = load("cornell-box")
    box, sheet = data.objects[1].meshes[0], data.objects[3].meshes[0]
    corners = np.concatenate([mesh.positions[mesh.faces] for mesh in (box, sheet)]).astype(float)
    part, closed = find_parts(corners, 1e-5)
    assert len(closed) == 2
    assert closed[part[0]] and not closed[part[-1]]


def test_backs_count_where_light_gets_to_them() -> None:
    """The cloths of the atrium have two lit sides; its columns, which have no lids, have one."""
    data = load("atrium")
    scene = upload(data)
    faces = find_faces(scene, still_scene(scene))
    names = [data.objects[index - 1].name for index in faces.unit // 2]
    shares = {
        name: faces.area[[n == name and b for n, b in zip(names, faces.back, strict=True)]].sum()
        / faces.area[[n == name and not b for n, b in zip(names, faces.back, strict=True)]].sum()
        for name in ("banners", "awnings", "columns", "slabs")
    }
    assert shares["banners"] > 0.95 and shares["awnings"] > 0.95
    assert shares["columns"] < 0.05 and shares["slabs"] == 0.0


def test_cover_finds_each_cell_of_a_square_once() -> None:
    corners = 8.0 * SQUARE[TWO][..., :2].astype(float)
    cell, _, weights = cover(corners, (10, 10))
    assert set(cell) == {y * 10 + x for y in range(8) for x in range(8)}
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
