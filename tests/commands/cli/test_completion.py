"""Shell completion, asked of a real shell."""

import shutil
import subprocess

import pytest

from snakejax.commands.cli import main


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed.")
@pytest.mark.parametrize(("words", "offered"), [(("fi",), "fit"), (("fit", "--ani"), "--animate")])
def test_bash_completes(words: tuple[str, ...], offered: str, capsys, tmp_path) -> None:
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion.sh"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    typed = " ".join(("snakejax", *words))
    ask = (
        f"source {script}; COMP_WORDS=({typed}); COMP_CWORD={len(words)}; COMP_LINE='{typed}'; "
        "completer=$(complete -p snakejax | sed 's/.*-F \\([^ ]*\\).*/\\1/'); "
        f"$completer snakejax {words[-1]} snakejax; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True)
    assert offered in done.stdout.split(), done.stderr


def test_the_script_for_fish_has_every_command_and_option(capsys) -> None:
    assert main(["completion", "fish"]) == 0
    script = capsys.readouterr().out
    assert all(f" {command}" in script for command in ("fit", "design", "help"))
    assert "-l with" in script or "--with" in script


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed.")
def test_fish_completes(capsys, tmp_path) -> None:
    assert main(["completion", "fish"]) == 0
    script = tmp_path / "snakejax.fish"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    ask = f"source {script}; complete -C 'snakejax expl'"
    done = subprocess.run(["fish", "-c", ask], capture_output=True, text=True)
    assert "explain" in done.stdout, done.stderr


def test_another_shell_is_refused_in_one_line(capsys) -> None:
    assert main(["completion", "powershell"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("snakejax: error:") and "bash" in said and said.count("\n") == 1
