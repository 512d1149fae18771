"""Scenes from packages, on archives and tools made here: what is fetched, what is refused, and that the others go on."""

from __future__ import annotations

import gzip
import hashlib
import io
import shutil
import subprocess
import tarfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from experiments.commands import fetch_scenes
from experiments.packages import fetching
from experiments.packages.manifest import Asset, read_manifest
from experiments.packages.tools import PackageError, download
from experiments.packages.unpacking import listing_digest, unpack
from experiments.scenes import load_scene
from experiments.scenes.assets import FOLDER_VARIABLE
from wkernels.errors import InputError

ROOT = Path(__file__).parents[2]
FILES = {"models/cube.obj": b"v 0 0 0\n", "models/parts/b.ply.gz": gzip.compress(b"ply\n"), "other/readme": b"no"}
TAKE = {"models/": ""}
TAKEN = {"cube.obj": b"v 0 0 0\n", "parts/b.ply": b"ply\n"}


def zipped(files: Mapping[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def tarred(files: Mapping[str, bytes], link: str | None = None) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as archive:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
        if link is not None:
            member = tarfile.TarInfo(link)
            member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
            archive.addfile(member)
    return out.getvalue()


def written(path: Path, data: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def package(folder: Path, kind: str, files: Mapping[str, bytes] = FILES) -> Path:
    if kind == "whl":
        return written(folder / "p.whl", zipped(files))
    if kind == "tgz":
        return written(folder / "p.tgz", tarred(files))
    for name, data in files.items():
        written(folder / "tree" / name, data)
    if kind == "folder":
        return folder / "tree"
    written(folder / "tree" / "DEBIAN" / "control", b"Package: p\nVersion: 1\nArchitecture: all\nMaintainer: m <m@m>\n")
    subprocess.run(["dpkg-deb", "--build", folder / "tree", folder / "p.deb"], check=True, capture_output=True)
    return folder / "p.deb"


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def digest(files: Mapping[str, bytes]) -> str:
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items())]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def asset(name: str = "cube", package: str = "p", **changes: object) -> Asset:
    keys = {"tool": "npm", "version": "1.0", "take": TAKE, "sha256": digest(TAKEN), "licence": "CC0"}
    return Asset.model_validate({"name": name, "package": package, **keys, **changes})


@pytest.mark.parametrize("kind", ["whl", "tgz", "folder", "deb"])
def test_packages_of_every_kind_give_the_same_files(tmp_path: Path, kind: str) -> None:
    if kind == "deb" and shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb here")
    unpack(package(tmp_path / "in", kind), None, TAKE, tmp_path / "out")
    assert contents(tmp_path / "out") == TAKEN
    assert listing_digest(tmp_path / "out") == digest(TAKEN)
    unpack(package(tmp_path / "in", kind), None, {"models/cube.obj": "a/c.obj"}, tmp_path / "one")
    assert contents(tmp_path / "one") == {"a/c.obj": TAKEN["cube.obj"]}


def test_an_archive_within_a_package_is_unpacked(tmp_path: Path) -> None:
    archive = written(tmp_path / "p.whl", zipped({"share/all.sh3f": zipped(FILES)}))
    unpack(archive, "share/all.sh3f", TAKE, tmp_path / "out")
    assert contents(tmp_path / "out") == TAKEN
    with pytest.raises(PackageError, match=r"it has no 'share/none\.zip'"):
        unpack(archive, "share/none.zip", TAKE, tmp_path / "none")


OUT = ["../evil.obj", "/tmp/evil.obj", "models/../../evil.obj", "models\\..\\evil.obj", "C:evil.obj"]


@pytest.mark.parametrize("name", OUT)
@pytest.mark.parametrize("kind", ["whl", "tgz"])
def test_paths_that_leave_the_folder_are_refused(tmp_path: Path, kind: str, name: str) -> None:
    """Wherever they stand in the archive, and whether they are wanted or not."""
    archive = package(tmp_path / "in", kind, {name: b"evil", **FILES})
    with pytest.raises(PackageError, match="leads out of its folder"):
        unpack(archive, None, TAKE, tmp_path / "in" / "out")
    assert not list(tmp_path.rglob("evil*"))
    with pytest.raises(PackageError, match="leads out of its folder"):
        unpack(package(tmp_path / "good", kind), None, {"models/cube.obj": name}, tmp_path / "in" / "out")
    assert not list(tmp_path.rglob("evil*"))


@pytest.mark.parametrize("kind", ["zip", "tgz", "folder"])
def test_links_are_no_files(tmp_path: Path, kind: str) -> None:
    archive = tmp_path / "p.tgz"
    if kind == "tgz":
        archive.write_bytes(tarred(FILES, link="models/passwd"))
    elif kind == "folder":
        archive = package(tmp_path, "folder")
        (archive / "models" / "passwd").symlink_to("/etc/passwd")
    else:
        archive = tmp_path / "p.whl"
        with zipfile.ZipFile(archive, "w") as out:
            link = zipfile.ZipInfo("models/passwd")
            link.external_attr = 0o120777 << 16
            out.writestr(link, "/etc/passwd")
    with pytest.raises(PackageError, match="its 'models/passwd' is no regular file"):
        unpack(archive, None, TAKE, tmp_path / "out")
    assert "passwd" not in contents(tmp_path / "out")


@pytest.mark.parametrize("kind", ["whl", "tgz"])
def test_broken_archives_and_missing_files_are_told(tmp_path: Path, kind: str) -> None:
    whole = package(tmp_path, kind)
    with pytest.raises(PackageError, match=r"it has no 'models/ball\.obj'"):
        unpack(whole, None, {"models/cube.obj": "c", "models/ball.obj": "b"}, tmp_path / "out")
    whole.write_bytes(whole.read_bytes()[: len(whole.read_bytes()) // 2])
    with pytest.raises(PackageError, match="cannot be unpacked"):
        unpack(whole, None, TAKE, tmp_path / "out")


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Packages called p are to be had, q is not; returns what was asked for."""
    archive, asked = package(tmp_path / "shelf", "tgz"), []

    def get(wanted: Asset, into: Path) -> Path:
        asked.append(wanted.package)
        if wanted.package != "p":
            raise PackageError("npm is not on this machine.")
        return archive

    monkeypatch.setattr(fetching, "download", get)
    return asked


def test_a_package_is_downloaded_once_and_what_is_there_stays(tmp_path: Path, shelf: list[str]) -> None:
    assets, folder, said = [asset(), asset("also")], tmp_path / "scenes", []
    assert fetching.fetch(assets, folder, said.append) == []
    assert shelf == ["p"] and len(said) == 2 and all("CC0" in line for line in said)
    assert contents(folder / "cube").keys() == {*TAKEN, fetching.SOURCE}
    assert "licence: CC0" in (folder / "cube" / fetching.SOURCE).read_text()
    assert sorted(path.name for path in folder.iterdir()) == ["also", "cube"]
    assert fetching.fetch(assets, folder, said.append) == [] and shelf == ["p"]
    (folder / "cube" / "cube.obj").write_bytes(b"changed")
    assert fetching.fetch(assets, folder, said.append) == [] and shelf == ["p", "p"]
    assert (folder / "cube" / "cube.obj").read_bytes() == TAKEN["cube.obj"]


def test_what_cannot_be_had_is_told_in_a_line_and_the_others_go_on(tmp_path: Path, shelf: list[str]) -> None:
    said: list[str] = []
    assets = [asset("absent", "q"), asset("other", sha256="0" * 64), asset("lacking", take={"a/": ""}), asset()]
    assert sorted(fetching.fetch(assets, tmp_path / "scenes", said.append)) == ["absent", "lacking", "other"]
    assert sorted(path.name for path in (tmp_path / "scenes").iterdir()) == ["cube"]
    told = {line.split()[1]: line for line in said if line.startswith("missing: ")}
    assert told["absent"] == "missing: absent (npm: q 1.0): npm is not on this machine."
    assert f"not those that were expected (sha256 {digest(TAKEN)})" in told["other"]
    assert "it has no 'a/'" in told["lacking"] and len(said) == 4


def tool(folder: Path, name: str, script: str) -> None:
    path = written(folder / name, f"#!/bin/sh\n{script}\n".encode())
    path.chmod(0o755)


def test_tools_are_asked_by_package_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_folder, into = tmp_path / "bin", tmp_path / "into"
    into.mkdir()
    monkeypatch.setenv("PATH", f"{bin_folder}:/usr/bin:/bin")
    tool(bin_folder, "npm", 'echo "$@" > asked; touch p-1.0.tgz')
    assert download(asset(), into) == into / "p-1.0.tgz" and (into / "asked").read_text() == "pack p@1.0\n"
    tool(bin_folder, "apt-get", 'echo "$@" > asked; touch p_1.0_all.deb')
    assert download(asset(tool="apt", version=None), into).suffix == ".deb"
    assert (into / "asked").read_text() == "download p\n"
    tool(bin_folder, "cargo", "mkdir -p vendor/p; cp Cargo.toml vendor/p/asked")
    assert 'p = "=1.0"' in (download(asset(tool="cargo"), into) / "asked").read_text()
    tool(bin_folder, "npm", "true")
    (into / "p-1.0.tgz").unlink()
    with pytest.raises(PackageError, match=r"left 0 \.tgz files"):
        download(asset(), into)


def test_tools_that_are_absent_or_fail_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    for name, program in (("npm", "npm"), ("apt", "apt-get"), ("cargo", "cargo")):
        with pytest.raises(PackageError, match=f"^{program} is not on this machine"):
            download(asset(tool=name), tmp_path)
    tool(tmp_path / "bin", "npm", "echo some words >&2; echo 'npm error 404 no such package' >&2; exit 3")
    with pytest.raises(PackageError, match="npm failed with status 3: npm error 404 no such package"):
        download(asset(), tmp_path)


def test_the_manifest_names_all_that_scene_files_want() -> None:
    assets = read_manifest()
    names = [one.name for one in assets]
    assert len(set(names)) == len(names) and all(one.version or one.tool == "apt" for one in assets)
    wanted = set()
    for file in (ROOT / "configs" / "scenes" / "real").glob("*.yaml"):
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
        named = [data.get("import", ""), *(mesh.get("file", "") for mesh in data.get("meshes", []))]
        wanted |= {name.removeprefix("fetched:").split("/")[0] for name in named if name.startswith("fetched:")}
    assert wanted == set(names)


def test_the_command_ends_with_2_for_names_that_it_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    assert fetch_scenes.main(["spnza"]) == 2
    assert "Did you mean 'sponza'?" in capsys.readouterr().err


def test_the_command_says_what_is_missing_and_ends_with_1(
    tmp_path: Path, shelf: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "scenes"))
    assert fetch_scenes.main(["sponza", "fox"]) == 1
    assert f"missing: sponza, fox; the others are in {tmp_path / 'scenes'}" in capsys.readouterr().out
    written(tmp_path / "file", b"")
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "file" / "scenes"))
    assert fetch_scenes.main(["sponza"]) == 2
    assert "cannot be written" in capsys.readouterr().err


SCENE = {
    "lights": [{"kind": "point", "position": [0, 9, 0]}],
    "camera": {"eye": [0, 2, 5], "target": [0, 0, 0]},
}


def test_scene_files_find_what_was_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    for wrong in ({"meshes": [{"file": "fetched:tri/a.obj"}]}, {"import": "fetched:tri/a.glb"}):
        with pytest.raises(InputError, match=r"no such file: .*tri.*; `make scenes` fetches the real scenes\."):
            load_scene(SCENE | wrong)
    written(tmp_path / "tri" / "a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = load_scene(SCENE | {"meshes": [{"file": "fetched:tri/a.obj"}]})
    assert [mesh.name for mesh in scene.meshes] == ["a"] and len(scene.meshes[0].faces) == 1
