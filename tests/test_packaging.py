"""The distribution is whole, its layers keep their order, its lock file matches, its README tells no tales."""

import ast
import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

from extremal.scripts.cli import COMMANDS

ROOT = Path(__file__).parent.parent
LAYERS = ("scripts", "tasks", "sim", "scenes", "estimator")  # each imports from itself and its right
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PYPROJECT["tool"]["setuptools"]
SOURCES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def imported_modules(path: Path) -> set[str]:
    """Names of all modules that a file imports anywhere, also within functions."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            found.add(node.module or "")
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_packages_are_the_folders_with_an_init() -> None:
    folders = {path.parent.relative_to(ROOT) for path in SOURCES if path.name == "__init__.py"}
    assert sorted(SETUPTOOLS["packages"]) == sorted("extremal." + ".".join(f.parts) for f in folders)
    for path in SOURCES:
        assert (path.parent / "__init__.py").exists(), f"{name_of(path)} is in no package"


def test_package_directories_and_typings_agree() -> None:
    nested = {name: "/".join(name.split(".")[1:]) for name in SETUPTOOLS["packages"]}
    assert SETUPTOOLS["package-dir"] == nested
    links = ROOT / "typings" / "extremal"
    assert {link.name for link in links.iterdir()} == set(LAYERS)
    for layer in LAYERS:
        assert (links / layer).is_symlink() and (links / layer).resolve() == ROOT / layer
        assert (ROOT / layer / "py.typed").exists()


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="needs the list of the repository's files")
def test_all_data_files_are_packaged() -> None:
    patterns = SETUPTOOLS["package-data"]
    command = ["git", "-C", str(ROOT), "ls-files", *LAYERS]
    for name in subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines():
        layer, inside = name.split("/", 1)
        program = layer == "scripts" and "." not in inside  # shell scripts, run from a checkout
        if not (inside.endswith(".py") or program):
            accepted = [*patterns["*"], *patterns.get(f"extremal.{layer}", [])]
            assert any(fnmatch(inside, pattern) for pattern in accepted), f"{name} is in no wheel"


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_imports_follow_the_layers(path: Path) -> None:
    modules = imported_modules(path)
    layer = path.relative_to(ROOT).parts[0]
    above = LAYERS[: LAYERS.index(layer)]
    wrong = {m for m in modules if any(f"{m}.".startswith(f"extremal.{name}.") for name in above)}
    assert not wrong, f"{layer} imports {wrong}"
    if layer == "estimator":
        roots = {m.split(".")[0] for m in modules}
        assert not roots & {"mujoco", "mink", "gymnasium", "trimesh", "OpenGL"}


@pytest.mark.parametrize("layer", ["scenes", "sim"])
def test_scenes_and_sim_take_only_values_from_the_estimator(layer: str) -> None:
    values = {"camera", "errors", "poses", "board", "calibration", "projection", "reading", "toml_values"}
    for path in (p for p in SOURCES if p.relative_to(ROOT).parts[0] == layer):
        for module in imported_modules(path):
            parts = module.split(".")
            if parts[:2] == ["extremal", "estimator"]:
                assert len(parts) > 2 and parts[2] in values, f"{name_of(path)} imports {module}"


def test_the_estimator_loads_without_mujoco() -> None:
    code = "import sys, extremal.estimator; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def requirements() -> list[Requirement]:
    groups = [PYPROJECT["project"]["dependencies"], PYPROJECT["dependency-groups"]["dev"]]
    return [Requirement(text) for group in groups for text in group]


def locked() -> list[Requirement]:
    text = (ROOT / "requirements.lock").read_text().replace("\\\n", " ")
    return [
        Requirement(line.split("--hash")[0]) for line in text.splitlines() if line and line[0] not in "# "
    ]


@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_the_lock_holds_every_dependency_within_its_bounds(version: str) -> None:
    environment = {k: str(v) for k, v in default_environment().items()}
    environment |= {"python_version": version, "python_full_version": f"{version}.1"}
    versions = {}
    for entry in locked():
        if entry.marker is None or entry.marker.evaluate(environment):
            assert entry.name not in versions, f"{entry.name} is locked twice for Python {version}"
            versions[entry.name] = next(iter(entry.specifier)).version
    for wanted in requirements():
        assert wanted.specifier.contains(versions[wanted.name.lower()]), f"{wanted} is locked otherwise"


def test_the_lock_has_hashes_and_names_no_host_or_folder() -> None:
    text = (ROOT / "requirements.lock").read_text()
    blocks = re.split(r"\n(?=\S)", text)
    assert all("--hash=sha256:" in block for block in blocks if not block.startswith("#"))
    assert not re.search(r"https?:|file:|--index|--find-links|--extra|(^|\s)/", text)


def test_the_readme_shows_commands_that_exist() -> None:
    readme = (ROOT / "README.md").read_text()
    for command in re.findall(r"^(?:\$ )?(?:\.venv/bin/)?extremal ([a-z][a-z-]*)", readme, re.MULTILINE):
        assert command in COMMANDS
    for command in re.findall(r"scripts/run ([a-z][a-z-]*)", readme):
        assert command == "test" or command in COMMANDS
    for link in re.findall(r"\]\(([^)#:]+)\)", readme):
        assert (ROOT / link).exists(), f"README.md links to {link}"


@pytest.mark.parametrize("script", ["scripts/run", "scripts/lock", "scripts/sbom", ".ci/run"])
def test_shell_scripts_can_run(script: str) -> None:
    path = ROOT / script
    assert path.stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", str(path)], check=False).returncode == 0
