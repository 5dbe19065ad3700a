"""What a release is made of: one version, notes, packages of what the code needs, and forms that can be read."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from types import ModuleType

import pytest
import yaml
from helpers.folders import ROOT
from jinja2 import Environment

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
FORMS = sorted((ROOT / ".github").rglob("*.yml"))


def test_one_version_is_next() -> None:
    """The newest of the CHANGELOG, which CITATION and a folder without .git have too."""
    newest = re.search(r"^## \[([\d.]+)\]", CHANGELOG, flags=re.MULTILINE)
    assert newest is not None
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"] == newest[1]
    assert PROJECT["tool"]["hatch"]["version"]["fallback-version"] == f"{newest[1]}.dev0"
    assert recipe()["package"]["version"] == f"{newest[1]}.dev0"


def test_release_notes_are_the_section_of_the_changelog() -> None:
    versions = re.findall(r"^## \[([\d.]+)\]", CHANGELOG, flags=re.MULTILINE)
    for version in versions:
        notes = subprocess.run([ROOT / ".ci" / "release-notes", f"v{version}"], capture_output=True, text=True)
        assert notes.returncode == 0 and notes.stdout.strip() in CHANGELOG
        assert notes.stdout.strip().startswith("### ") and "\n## [" not in notes.stdout
    missing = subprocess.run([ROOT / ".ci" / "release-notes", "99.9"], capture_output=True, text=True)
    assert missing.returncode == 1 and "99.9" in missing.stderr


def recipe() -> dict:
    """The conda recipe as conda-build reads it outside of a tag."""
    text = (ROOT / ".conda" / "meta.yaml").read_text(encoding="utf-8")
    return yaml.safe_load(Environment().from_string(text).render(environ={}, PYTHON="python"))


def test_the_conda_recipe_needs_what_the_project_needs() -> None:
    spaced = [re.sub(r"([><=])", r" \1", line, count=1) for line in PROJECT["project"]["dependencies"]]
    other_names = {"matplotlib": "matplotlib-base", "flatbuffers": "python-flatbuffers"}
    needed = {f"{other_names.get(name, name)} {limit}" for name, limit in (line.split(" ", 1) for line in spaced)}
    needed.add(f"python {PROJECT['project']['requires-python']}")
    assert set(recipe()["requirements"]["run"]) == needed
    commands = [f"{name} = {target}" for name, target in PROJECT["project"]["scripts"].items()]
    assert recipe()["build"]["entry_points"] == commands


def test_the_workflows_run_the_scripts_of_ci() -> None:
    tests, release = ((ROOT / ".github" / "workflows" / f"{name}.yml").read_text() for name in ("tests", "release"))
    for text in (tests, release):
        called = re.findall(r"run: (\.ci/\S+)", text)
        assert called and all((ROOT / script).stat().st_mode & 0o111 for script in called)
    assert "run: .ci/run\n" in tests and "run: .ci/package\n" in tests and ".ci/release-notes" in release
    classifiers = PROJECT["project"]["classifiers"]
    known = [c.rpartition(" ")[2] for c in classifiers if re.search(r":: 3\.\d+$", c)]
    assert yaml.safe_load(tests)["jobs"]["run"]["strategy"]["matrix"]["python"] == known


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.name)
def test_forms_can_be_read(form) -> None:
    content = yaml.safe_load(form.read_text(encoding="utf-8"))
    for part in content.get("body", ()):
        assert part["type"] in ("input", "textarea") and part["attributes"]["label"]


@pytest.fixture
def outside_of_repository(monkeypatch: pytest.MonkeyPatch):
    """That function of the build, which runs where hatchling is installed."""
    interface = ModuleType("hatchling.metadata.plugin.interface")
    interface.MetadataHookInterface = object
    monkeypatch.setitem(sys.modules, interface.__name__, interface)
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.outside_of_repository


def test_the_readme_of_a_package_links_to_the_repository(outside_of_repository) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    known = {"GITHUB_SERVER_URL": "https://forge", "GITHUB_REPOSITORY": "a/b", "GITHUB_SHA": "0123"}
    shown = outside_of_repository(readme, known)
    assert "](https://forge/a/b/raw/0123/docs/gallery/fall.png)" in shown
    assert "[Apache-2.0](https://forge/a/b/blob/0123/LICENSE)" in shown
    for text in (shown, outside_of_repository(readme, {})):
        assert re.findall(r"\]\((?!https?://)[^)]*\)", text) == []
    assert "Licence: Apache-2.0." in outside_of_repository(readme, {})


@pytest.mark.long
def test_packages_install_and_run_on_every_python_that_is_there() -> None:
    """Wheel, source archive and plain folder, each in an empty environment; it needs a package registry."""
    done = subprocess.run([ROOT / ".ci" / "package"], capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("snakejax ") >= 3
