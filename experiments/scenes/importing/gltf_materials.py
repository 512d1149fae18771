"""What visibility asks of glTF materials: their colour, and where alphaMode MASK leaves nothing of the surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from experiments.scenes.importing.description import Grey
from experiments.scenes.masks import decoded_channel
from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.gltf_primitives import Primitive, texture_coordinates
from experiments.scenes.meshes.reading import MeshError, Tell
from wkernels.scene.cutouts import Mask, Wrap

_WRAPS: dict[int, Wrap] = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
_NEAREST = 9728
_TRANSFORM = "KHR_texture_transform"


class Materials:
    """The materials of one file; tells once of each that is drawn otherwise than the file says."""

    def __init__(self, document: Document, tell: Tell) -> None:
        self._document, self._tell = document, tell
        self._images: dict[int, np.ndarray] = {}
        self._opaque: dict[str, set[int]] = {}

    def finish(self) -> None:
        """Tells of the materials that are drawn opaque though they are not."""
        for mode, materials in sorted(self._opaque.items()):
            self._tell(f"{len(materials)} materials with alphaMode {mode} are drawn opaque.")

    def diffuse(self, primitive: Primitive) -> Grey | None:
        """The base colour; without a material or with one that leaves it out, None."""
        if "material" not in primitive.data:
            return None
        surface = self._surface(primitive)
        if "baseColorFactor" not in surface:
            return None
        red, green, blue = np.clip(self._factor(primitive, surface)[:3], 0.0, 1.0).tolist()
        return red, green, blue

    def mask(self, primitive: Primitive) -> Mask | None:
        """Where a primitive of alphaMode MASK is there; None where it is everywhere, or drawn as if it were."""
        if "material" not in primitive.data:
            return None
        document, index = self._document, primitive.data["material"]
        material = document.item("materials", index)
        mode = document.get(material, "alphaMode", str, "OPAQUE")
        if mode != "MASK":
            if mode != "OPAQUE":
                self._opaque.setdefault(mode, set()).add(index)
            return None
        held = {"alphaCutoff": [material.get("alphaCutoff", 0.5)]}
        cutoff = float(document.numbers(held, "alphaCutoff", 1, [], f"material {index}")[0])
        surface = self._surface(primitive)
        factor = float(self._factor(primitive, surface)[3])
        if "COLOR_0" in document.get(primitive.data, "attributes", dict, {}):
            self._tell(f"the vertex colours of material {index} do not count for its alpha.")
        texture = document.get(surface, "baseColorTexture", dict)
        if texture is None:
            if factor >= cutoff:
                return None
            return Mask(np.zeros((len(primitive.vertices), 2)), np.zeros((1, 1), np.float32), 0.5)
        return self._textured(primitive, texture, cutoff / factor if factor > 0.0 else np.inf)

    def _textured(self, primitive: Primitive, texture: dict[str, Any], cutoff: float) -> Mask | None:
        document, index = self._document, primitive.data["material"]
        held = document.item("textures", texture.get("index"))
        if held.get("source") is None:
            self._tell(f"the texture of material {index} is of a kind that is not read; it is drawn opaque.")
            return None
        extension = document.get(document.get(texture, "extensions", dict, {}), _TRANSFORM, dict, {})
        channel = extension.get("texCoord", texture.get("texCoord", 0))
        uv = texture_coordinates(document, primitive, channel)
        if uv is None:
            self._tell(f"a primitive of material {index} has no texture coordinates {channel}; it is drawn opaque.")
            return None
        wraps: list[Wrap] = ["repeat", "repeat"]
        nearest = False
        if "sampler" in held:
            sampler = document.item("samplers", held["sampler"])
            wraps = [_WRAPS.get(sampler.get(key, 10497), "repeat") for key in ("wrapS", "wrapT")]
            nearest = sampler.get("magFilter") == _NEAREST
        return Mask(self._moved(uv, extension), self._alpha(held["source"]), cutoff, (wraps[0], wraps[1]), nearest)

    def _moved(self, uv: np.ndarray, extension: dict[str, Any]) -> np.ndarray:
        """Texture coordinates under KHR_texture_transform: scaled, turned, then moved."""
        if not extension:
            return uv
        document = self._document
        scale, offset = (
            document.numbers(extension, key, 2, default, _TRANSFORM)
            for key, default in (("scale", [1.0, 1.0]), ("offset", [0.0, 0.0]))
        )
        turn = float(document.numbers({"rotation": [extension.get("rotation", 0.0)]}, "rotation", 1, [], _TRANSFORM)[0])
        cos, sin = np.cos(turn), np.sin(turn)
        out: np.ndarray = (uv * scale) @ np.array([[cos, sin], [-sin, cos]]).T + offset
        return out

    def _alpha(self, source: Any) -> np.ndarray:
        if source not in self._images:
            image = self._document.item("images", source)
            uri = self._document.get(image, "uri", str)
            if uri is None:
                data, _ = self._document.view_bytes(image.get("bufferView"))
                name = f"image {source}"
            else:
                data = self._document.external(uri, f"image {source}")
                name = f"image {source}" if uri.startswith("data:") else Path(unquote(uri)).name
            self._images[source] = decoded_channel(data, name)
        return self._images[source]

    def _surface(self, primitive: Primitive) -> dict[str, Any]:
        material = self._document.item("materials", primitive.data["material"])
        out: dict[str, Any] = self._document.get(material, "pbrMetallicRoughness", dict, {})
        return out

    def _factor(self, primitive: Primitive, surface: dict[str, Any]) -> np.ndarray:
        what = f"material {primitive.data['material']}"
        factor = self._document.numbers(surface, "baseColorFactor", 4, [1.0, 1.0, 1.0, 1.0], what)
        if factor[3] < 0.0:
            raise MeshError(f"the baseColorFactor of {what} has a negative alpha.")
        return factor
