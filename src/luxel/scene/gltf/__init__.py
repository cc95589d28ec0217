"""glTF 2.0 files: container, schema, nodes, meshes, materials, lights, animation, each in a module of its own."""

from luxel.scene.gltf.load import load_gltf

__all__ = ["load_gltf"]
