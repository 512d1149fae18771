"""``--set key.path=value``: changes to an experiment file from the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from experiments.config.messages import Loc, shown
from experiments.config.source import Source, parse_yaml
from wkernels.errors import InputError


def apply_overrides(
    source: Source, overrides: Iterable[str], inline: Callable[[Source, Loc], Source] | None = None
) -> Source:
    """The source with every ``key.path=value`` applied, in order; list items are addressed by index.

    Args:
        source: The experiment file.
        overrides: Texts as given to ``--set``; values are YAML.
        inline: Called before the first change inside a scene that is a file name, with its place: ``scene`` or an item
            of ``scenes``; puts the scene's data there. None for files without scenes.

    Raises:
        InputError: No ``=``, an empty key, a value that is no YAML, or a path through something without keys.
    """
    for text in overrides:
        origin = f"--set {text}"
        path, equals, value_text = text.partition("=")
        keys = path.strip().split(".")
        if not equals or not all(keys):
            raise InputError("must have the form key.path=value.", file=origin)
        scene = _scene_file(source, keys)
        if scene and inline:
            source = inline(source, scene)
        value = parse_yaml(value_text, origin).data if value_text.strip() else None
        source, loc = _located(source, keys, origin)
        source = source.replaced(loc, value, origin)
    return source


def _scene_file(source: Source, keys: list[str]) -> Loc:
    """Place of the scene that the keys lead into, if it is a file name; else empty."""
    if keys[0] == "scene" and len(keys) > 1 and isinstance(source.data.get("scene"), str):
        return ("scene",)
    scenes = source.data.get("scenes")
    if keys[0] == "scenes" and len(keys) > 2 and isinstance(scenes, list) and keys[1] in map(str, range(len(scenes))):
        return ("scenes", int(keys[1])) if isinstance(scenes[int(keys[1])], str) else ()
    return ()


def _located(source: Source, keys: list[str], origin: str) -> tuple[Source, Loc]:
    """The key path with list indices as numbers, and the source with what lies on the way made into mappings."""
    loc: Loc = ()
    value: Any = source.data
    for key in keys:
        where = ".".join(str(part) for part in loc)
        part: str | int = key
        if isinstance(value, list):
            part = _index(key, len(value), where, origin)
        elif isinstance(value, str) and value == key and loc and isinstance(loc[-1], int):
            value = {key: None}  # a technique given by name alone gets parameters: `- pcf` becomes `- pcf: {...}`
            source = source.replaced(loc, value, origin)
        elif value is not None and not isinstance(value, dict):
            raise InputError(f"'{where}' is {shown(value)} and has no '{key}' in it.", file=origin)
        value = value[part] if isinstance(part, int) else (value or {}).get(part)
        loc = (*loc, part)
    return source, loc


def _index(key: str, count: int, where: str, origin: str) -> int:
    if not (key.isascii() and key.isdigit()):
        raise InputError(f"'{where}' is a list; '{key}' must be the index of an item, 0 to {count - 1}.", file=origin)
    if int(key) >= count:
        items = f"{count} item{'s' if count != 1 else ''}"
        raise InputError(f"'{where}' has {items}; there is no item {key} (the first is 0).", file=origin)
    return int(key)
