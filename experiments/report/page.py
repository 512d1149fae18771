"""How pages are made: templates of the kinds on one base; pages hold their style, scripts and data and load nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from experiments.report.style import COLORS, DARK_COLORS
from experiments.results.store import Store
from experiments.results.tables import write_text
from wkernels.errors import InputError

TEMPLATES = Path(__file__).parent / "templates"

# One script element: every file sees what the files before it define, and nothing leaks into the page.
SCRIPTS = (
    "core.js", "scales.js", "tooltip.js", "legend.js", "scatter.js", "curves.js", "colours.js", "fields.js",
    "stage.js", "steer.js", "viewer.js", "stability.js", "tables.js", "pictures.js", "start.js",
)  # fmt: skip


def write_page(out: Path, template: Path, **values: Any) -> Path:
    """Writes report.html of a result folder and returns its path; InputError where it cannot be written."""
    page = render(template, **values)
    with writing_report(out):
        write_text(out / "report.html", page)
    return out / "report.html"


@contextmanager
def writing_report(out: Path) -> Iterator[None]:
    """Turns a failure to write into the one message."""
    try:
        yield
    except OSError as error:
        raise InputError(f"the report cannot be written ({error.strerror or error}).", file=out) from error


def record(store: Store) -> dict[str, Any]:
    """What every page tells of its run: values for a template."""
    environment = store.environment()
    told = {name: environment[name] for name in ("run", "environment", "identity")}
    return told | {"config": (store.out / "config.yaml").read_text(encoding="utf-8")}


def render(template: Path, **values: Any) -> str:
    """A page from a template, which may extend ours; text is escaped, and every name must be given."""
    loader = FileSystemLoader([template.parent, TEMPLATES])
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters |= {
        "number": number,
        "plain": plain,
        "percent": percent,
        "json": json_script,
        "exact": exact,
        "size": size,
    }
    return environment.get_template(template.name).render(style=_style(), scripts=_scripts(), **values)


def _asset(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _style() -> Markup:
    def palette(colors: Sequence[str]) -> str:
        return ":root { " + " ".join(f"--c{i}: {color};" for i, color in enumerate(colors)) + " }"

    dark = f"@media screen and (prefers-color-scheme: dark) {{ {palette(DARK_COLORS)} }}"
    return Markup("\n".join([_asset("report.css"), palette(COLORS), dark]))  # our own files, no input


def _scripts() -> Markup:
    body = "\n".join(f"// ---- {name}\n{_asset(name)}" for name in SCRIPTS)
    return Markup(f'(() => {{\n"use strict";\n{body}\n}})();')


def json_script(data: Any) -> Markup:
    """JSON for a script element: numbers that JSON lacks become null, and nothing in it can end the element."""
    text = json.dumps(_finite(data), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, bool | np.bool_):
        return bool(data)
    if isinstance(data, float | np.floating):
        return float(f"{data:.7g}") if np.isfinite(data) else None
    return int(data) if isinstance(data, np.integer) else data


def number(value: Any, digits: int = 3) -> str:
    """A number for people: three significant digits, empty where unknown."""
    if value is None or not np.isfinite(value):
        return ""
    if value == 0.0:
        return "0"
    size = abs(float(value))
    if 1e-4 <= size < 1e6:
        decimals = max(0, digits - 1 - int(np.floor(np.log10(size))))
        return f"{value:.{decimals}f}"
    return f"{value:.{digits - 1}e}"


def exact(value: Any) -> str:
    """A number for sorting, empty where unknown."""
    return "" if value is None or not np.isfinite(value) else f"{float(value):.9g}"


def size(characters: float) -> str:
    """How much of a page something takes."""
    return f"{characters / 1e6:.1f} MB" if characters >= 1e5 else f"{max(1, round(characters / 1e3))} kB"


def percent(share: float) -> str:
    """A share in percent, empty where unknown."""
    return "" if not np.isfinite(share) else f"{100.0 * share:.1f} %"


def plain(value: Any) -> str:
    """A value of environment.json or of a configuration for people."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {plain(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(plain(item) for item in value)
    return "" if value is None else str(value)
