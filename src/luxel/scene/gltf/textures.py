"""glTF textures, samplers and images to `Texture`.

An image that is missing or cannot be decoded is named in a warning, and the material's factor stands alone.
"""

from __future__ import annotations

import io
from typing import Any, Literal

import numpy as np
from PIL import Image

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.compressed import BASIS, decode_basis
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.schema import GltfTexture, Sampler, TextureInfo, read_entry
from luxel.scene.gltf.uris import OutsideError, is_embedded
from luxel.scene.model import Texture

Wrap = Literal["repeat", "clamp", "mirror"]

WRAP_MODES: dict[int | None, Wrap] = {None: "repeat", 10497: "repeat", 33071: "clamp", 33648: "mirror"}
FILTER_NEAREST = 9728
LAST_UV_SET = 1
# Extensions that name the same image in another format; tried in this order, before the plain image.
IMAGE_EXTENSIONS = (BASIS, "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")
KTX2_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"


class UnreadableImage(Exception):
    """Why an image cannot be had, as the words that follow "Texture "."""


class TextureReader:
    """The textures of one document; images are decoded once and shared."""

    def __init__(self, document: Document, reader: AccessorReader) -> None:
        self.document = document
        self.reader = reader
        self._images: dict[int, np.ndarray | UnreadableImage] = {}
        self._opaque_images: dict[int, np.ndarray] = {}
        self.second_set: int | None = None
        """Which of the file's texture coordinates beyond the first the material that is being read uses."""

    def read(self, info: TextureInfo | Any, label: str, *, srgb: bool, opaque: bool = True) -> Texture | None:
        """The texture behind a textureInfo (or its plain JSON), or None where there is none to read.

        `opaque` drops its alpha. Raises `LuxelError` for indices out of range.
        """
        if info is None:
            return None
        if not isinstance(info, TextureInfo):
            info = read_entry(TextureInfo, info, f"a texture of {label}")
        document = self.document
        texture = document.item(document.gltf.textures, info.index, f"texture of {label}")
        transform = info.extensions.get("KHR_texture_transform", {})
        uv_set = transform.get("texCoord", info.texCoord or 0)
        if not isinstance(uv_set, int) or uv_set < 0 or (uv_set > 0 and self.second_set not in (None, uv_set)):
            document.warn(
                f"Textures that use TEXCOORD_{uv_set} are ignored: luxel reads set 0 and one more a material."
            )
            return None
        if uv_set > 0:
            self.second_set, uv_set = uv_set, 1
        source, image = self._best_image(texture, info.index)
        if image is None:
            return None
        if opaque and image.shape[2] == 4:
            image = self._opaque_images.setdefault(source, np.ascontiguousarray(image[:, :, :3]))
        sampler = Sampler()
        if texture.sampler is not None:
            sampler = document.item(document.gltf.samplers, texture.sampler, "sampler")
        return Texture(
            image=image,
            srgb=srgb,
            wrap_u=self._wrap(sampler.wrapS),
            wrap_v=self._wrap(sampler.wrapT),
            nearest=sampler.magFilter == FILTER_NEAREST,
            uv_set=uv_set,
            transform=self._uv_transform(transform, label),
        )

    def _best_image(self, texture: GltfTexture, index: int) -> tuple[int, np.ndarray | None]:
        """The first image of `texture` that can be read, and its number; None, with a warning, where none can."""
        named = [texture.extensions[name].get("source") for name in IMAGE_EXTENSIONS if name in texture.extensions]
        sources = [source for source in (*named, texture.source) if source is not None]
        if not sources:
            self.document.warn(f"Texture {index} has no image in a known format; the factor is used alone.")
        for source in sources:
            if source not in self._images:
                try:
                    self._images[source] = self._load_image(source)
                except UnreadableImage as error:
                    self._images[source] = error
            image = self._images[source]
            if isinstance(image, np.ndarray):
                return source, image
        for source in sources[:1]:
            self.document.warn(f"Texture {self._images[source]}; the factor is used alone.")
        return -1, None

    def _wrap(self, mode: int | None) -> Wrap:
        if mode not in WRAP_MODES:
            self.document.warn(f"The texture wrap mode {mode} is unknown and is taken as repeat.")
        return WRAP_MODES.get(mode, "repeat")

    def _uv_transform(self, entry: dict[str, Any], label: str) -> np.ndarray:
        """(3, 3) of KHR_texture_transform: scale, then rotate counter-clockwise as seen in the image, then shift.

        v grows downwards, so counter-clockwise is [[c, s], [-s, c]]: the extension's prose and its example of the
        lower left quadrant (its GLSL snippet has the sign of the sine the other way round).
        """
        where, numbers = f"KHR_texture_transform of {label}", self.document.numbers
        shift = numbers(entry.get("offset") or (0.0, 0.0), 2, where)
        scale = numbers(entry.get("scale") or (1.0, 1.0), 2, where)
        angle = self.document.number(entry.get("rotation") or 0.0, where)
        cosine, sine = np.cos(angle), np.sin(angle)
        return np.array(
            [
                [cosine * scale[0], sine * scale[1], shift[0]],
                [-sine * scale[0], cosine * scale[1], shift[1]],
                [0.0, 0.0, 1.0],
            ],
            dtype=np.float32,
        )

    def _load_image(self, index: int) -> np.ndarray:
        """Image `index` as (H, W, 3 or 4). Raises `UnreadableImage`."""
        entry = self.document.item(self.document.gltf.images, index, "image")
        label = f"image {index}"
        if entry.bufferView is not None:
            data = self.reader.view_bytes(entry.bufferView)
        elif entry.uri is None:
            raise UnreadableImage(f"{label} has no data")
        else:
            label = label if is_embedded(entry.uri) else f"file {entry.uri}"
            try:
                data = self.document.read_uri(entry.uri)
            except OutsideError as error:
                raise UnreadableImage(f"file {error}") from error
            except FileNotFoundError as error:
                raise UnreadableImage(f"{label} is missing") from error
            except (OSError, ValueError) as error:
                raise UnreadableImage(f"{label} cannot be read ({error})") from error
        try:
            return decode_image(data)
        except Exception as error:  # the decoders raise many types on damaged data
            unknown = isinstance(error, Image.UnidentifiedImageError) or not str(error)
            cause = type(error).__name__ if unknown else " ".join(str(error).split())
            raise UnreadableImage(f"{label} cannot be decoded ({cause})") from error


def decode_image(data: bytes) -> np.ndarray:
    """An encoded image as (H, W, 3 or 4) uint8, or float32 in 0..1 for 16-bit grey. Raises what its decoder raises."""
    if data.startswith(KTX2_MAGIC):
        return decode_basis(data)
    with Image.open(io.BytesIO(data)) as image:
        if image.mode.startswith("I"):
            grey = np.asarray(image, dtype=np.float32) / np.float32(65535.0)
            return np.repeat(np.clip(grey, 0.0, 1.0)[:, :, None], 3, axis=2)
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        return np.array(image.convert("RGBA" if has_alpha else "RGB"))
