"""The node tree of a glTF file: global matrices at any time, at rest or animated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from luxel.scene.gltf.animation import Track
from luxel.scene.gltf.document import Document
from luxel.scene.model import Node

# Files hide things by a scale of zero; this keeps their matrices invertible.
SMALLEST_SCALE = 1e-6
# Volumes must fit into float32.
LARGEST_ENTRY = 1e12
REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
TRS_PATHS = tuple(REST)
VISIBILITY = "KHR_node_visibility"


class NodeTree:
    """All nodes of a document and their tracks. Matrices are (4, 4) float64 and act on column vectors.

    Plain data after construction, so that the callables which hold it can be copied to other processes.
    Raises `LuxelError` for an index out of range, a cycle, a node with two parents or numbers that are not finite.
    """

    def __init__(self, document: Document, tracks: Mapping[tuple[int, str], Track]) -> None:
        nodes = document.gltf.nodes
        self.tracks = dict(tracks)
        self.parents, self.order = _sort_by_parent(document)
        animated = {node for node, path in self.tracks if path != "weights"}
        self.rest = tuple(_read_all(document, path) for path in TRS_PATHS)
        """Translations (N, 3), rotations (N, 4) and scales (N, 3) where no track moves them."""
        self.local = compose(*self.rest)
        for index, node in enumerate(nodes):
            if node.matrix is not None:
                self.local[index] = document.numbers(node.matrix, 16, f"matrix of node {index}").reshape(4, 4).T
                for table, value in zip(self.rest, decompose(self.local[index]), strict=True):
                    table[index] = value
        self.moving = np.zeros(len(nodes), dtype=bool)
        """(N,) True for nodes that the animation moves, itself or by an ancestor."""
        for index in self.order:
            parent = self.parents[index]
            self.moving[index] = index in animated or (parent >= 0 and self.moving[parent])
        self._animated = animated
        self._still = self._accumulate(self.local, np.zeros((len(nodes), 4, 4)), self.order)
        self._moving_order = [index for index in self.order if self.moving[index]]
        self._latest: tuple[float, np.ndarray] | None = None
        too_large = ~(np.abs(self.world_all(0.0)) < LARGEST_ENTRY).all(axis=(1, 2))
        if too_large.any():
            document.fail(f"the transform of node {int(np.argmax(too_large))} is too large")

    def world_all(self, time: float) -> np.ndarray:
        """(N, 4, 4) global matrices of all nodes at `time` seconds. Do not write into the result."""
        if not self._moving_order:
            return self._still
        latest = self._latest
        if latest is not None and latest[0] == time:
            return latest[1]
        local = self.local.copy()
        for index in self._animated:
            local[index] = compose(*(self._sample(index, path, time) for path in TRS_PATHS))
        world = self._accumulate(local, self._still.copy(), self._moving_order)
        self._latest = (time, world)
        return world

    def world(self, node: int, time: float = 0.0) -> np.ndarray:
        """(4, 4) global matrix of one node; the caller owns it."""
        return self.world_all(time)[node].copy()

    def _sample(self, node: int, path: str, time: float) -> np.ndarray:
        track = self.tracks.get((node, path))
        return self.rest[TRS_PATHS.index(path)][node] if track is None else track.sample(time)

    def _accumulate(self, local: np.ndarray, world: np.ndarray, order: list[int]) -> np.ndarray:
        for index in order:
            parent = self.parents[index]
            world[index] = local[index] if parent < 0 else world[parent] @ local[index]
        return world


def hidden_nodes(document: Document, tree: NodeTree) -> np.ndarray:
    """(N,) True for nodes that KHR_node_visibility hides: by themselves, or by a node above them."""
    hidden = np.zeros(len(document.gltf.nodes), dtype=bool)
    for index in tree.order:
        stated = document.gltf.nodes[index].extensions.get(VISIBILITY, {}).get("visible", True)
        if not isinstance(stated, bool):
            document.fail(f"the visibility of node {index} must be true or false, not {stated!r}")
        parent = tree.parents[index]
        hidden[index] = not stated or (parent >= 0 and hidden[parent])
    return hidden


def record_nodes(document: Document, tree: NodeTree, place: dict[int, int]) -> list[Node]:
    """The file's nodes as `SceneData.nodes` keeps them: those that have a `place` there, in its order."""
    worlds, found = tree.world_all(0.0), []
    for index in place:
        node = document.gltf.nodes[index]
        stated = {name: getattr(node, name) for name in ("matrix", *TRS_PATHS)}
        transform = {name: [float(value) for value in values] for name, values in stated.items() if values is not None}
        found.append(Node(node.name, place.get(tree.parents[index]), transform, worlds[index].copy()))
    return found


@dataclass
class NodeMotion:
    """`Object.motion`: the node's global matrix, times a fixed one on the object's side."""

    tree: NodeTree
    node: int
    inner: np.ndarray

    def __call__(self, time: float) -> np.ndarray:
        return self.tree.world(self.node, time) @ self.inner


@dataclass
class RigidMotion:
    """`Light.motion` and `Camera.motion`: the node's pose without scale, times a fixed matrix on the inner side."""

    tree: NodeTree
    node: int
    inner: np.ndarray

    def __call__(self, time: float) -> np.ndarray:
        return rigid(self.tree.world(self.node, time)) @ self.inner


def rigid(matrix: np.ndarray) -> np.ndarray:
    """The same place and -Z direction as `matrix` (4, 4) without scale, shear or mirroring; +Y as near as it can be."""
    pose = np.eye(4)
    pose[:3, 3] = matrix[:3, 3]
    backward, up = matrix[:3, 2], matrix[:3, 1]
    length = np.linalg.norm(backward)
    if length == 0.0:
        return pose
    backward = backward / length
    right = _cross(up, backward)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(up):
        right = _cross(np.eye(3)[int(np.argmin(np.abs(backward)))], backward)
    right = right / np.linalg.norm(right)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, _cross(backward, right), backward
    return pose


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of two vectors (3,); NumPy's takes ten times as long for a single one."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def compose(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(..., 4, 4) from (..., 3) translations, (..., 4) quaternions x y z w of any length and (..., 3) scales."""
    norm = (rotation * rotation).sum(axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(rotation * np.sqrt(2.0 / np.where(norm > 0.0, norm, np.inf)), -1, 0)
    rows = [
        [1.0 - (y * y + z * z), x * y - z * w, x * z + y * w],
        [x * y + z * w, 1.0 - (x * x + z * z), y * z - x * w],
        [x * z - y * w, y * z + x * w, 1.0 - (x * x + y * y)],
    ]
    matrix = np.zeros((*translation.shape[:-1], 4, 4))
    matrix[..., :3, :3] = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    matrix[..., :3, :3] *= np.where(np.abs(scale) < SMALLEST_SCALE, SMALLEST_SCALE, scale)[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def decompose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, quaternion x y z w and scale of a (4, 4) without shear; a mirror goes to the scale's x."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        scale[0] = -scale[0]
    r = matrix[:3, :3] / np.where(scale == 0.0, 1.0, scale)
    # The quaternion is the eigenvector of the largest eigenvalue (Bar-Itzhack 2000): no case distinctions.
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    rotation = np.linalg.eigh(k)[1][:, -1]
    return matrix[:3, 3].copy(), rotation, scale


def _read_all(document: Document, path: str) -> np.ndarray:
    """(N, C) translations, rotations or scales as the nodes state them."""
    default = REST[path]
    table = np.tile(np.array(default), (len(document.gltf.nodes), 1))
    for index, node in enumerate(document.gltf.nodes):
        value = getattr(node, path)
        if value is not None and node.matrix is None:
            table[index] = document.numbers(value, len(default), f"{path} of node {index}")
    return table


def _sort_by_parent(document: Document) -> tuple[list[int], list[int]]:
    """Each node's parent (-1: none), and an order in which parents come first."""
    nodes = document.gltf.nodes
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.children:
            document.item(nodes, child, f"child of node {index}, node")
            if parents[child] >= 0:
                document.fail(f"node {child} is the child of nodes {parents[child]} and {index}, so it is no tree")
            parents[child] = index
    order = [index for index, parent in enumerate(parents) if parent < 0]
    for index in order:
        order.extend(nodes[index].children)
    if len(order) < len(nodes):
        trapped = min(set(range(len(nodes))) - set(order))
        document.fail(f"its node tree has a cycle through node {trapped}")
    return parents, order
