"""Procedural scenes, one file each: ``NAME.py`` holds ``generate(*, seed, triangles, **params) -> list[Mesh]``.

The parameters of ``generate`` are keyword-only, annotated and have defaults; the annotations (``Annotated[int,
Field(ge=1)]``) are what scene files are checked against. The same parameters give the same meshes to the last bit,
and the number of triangles is within 1 % of ``triangles``. Files that begin with an underscore are no generators.
"""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import create_model

from experiments.scenes.schema import MeshOptions
from wkernels.scene.model import Mesh

Generate = Callable[..., list[Mesh]]


def names() -> list[str]:
    """The names of all generators, sorted."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.py") if not path.stem.startswith("_"))


def load(name: str) -> Generate:
    """The ``generate`` function of the generator ``name``, which must be one of ``names()``."""
    module = importlib.import_module(f"{__name__}.{name}")
    generate: Generate = module.generate
    return generate


def parameters_model(name: str) -> type[MeshOptions]:
    """A model of everything a mesh entry with ``generate: name`` may say."""
    generate = load(name)
    hints = typing.get_type_hints(generate, include_extras=True)
    fields: dict[str, Any] = {
        key: (hints[key], parameter.default) for key, parameter in inspect.signature(generate).parameters.items()
    }
    return create_model(f"Generate_{name}", __base__=MeshOptions, generate=(str, ...), **fields)


def run(options: MeshOptions) -> list[Mesh]:
    """The meshes of a validated entry."""
    own = {key: getattr(options, key) for key in type(options).model_fields if key not in MeshOptions.model_fields}
    return load(own.pop("generate"))(**own)
