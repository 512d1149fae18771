"""``wkernels new-technique``: one file that runs as it stands."""

from __future__ import annotations

import importlib.resources
import keyword
import re
from pathlib import Path
from string import Template

from algorithms.plugins import load_all
from wkernels.errors import InputError


def write_technique(name: str, folder: Path) -> Path:
    """Writes ``folder/name.py`` and says how to run it.

    Args:
        name: snake_case; also the technique's key in experiment files.
        folder: An existing folder.

    Raises:
        InputError: The name cannot be used or is taken, the file exists, or it cannot be written.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) or keyword.iskeyword(name):
        raise InputError(f"'{name}' cannot be a technique's name; use snake_case, such as 'my_shadow_map'.")
    if name in load_all():
        raise InputError(f"there is a technique '{name}' already; choose another name.")
    if not folder.is_dir():
        raise InputError(f"--dir {folder}: there is no such folder.")
    path = folder / f"{name}.py"
    template = importlib.resources.files("experiments.commands").joinpath("templates/technique.txt")
    text = Template(template.read_text(encoding="utf-8")).substitute(
        name=name, class_name="".join(part.capitalize() for part in name.split("_")), title=name.replace("_", " ")
    )
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError("exists already and is left as it is.", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}.", file=path) from None
    print(f"{path} written. Try it:")
    print(f"  wkernels render configs/scenes/overlap.yaml --technique {name} --plugin {path} --out {name}.png")
    return path
