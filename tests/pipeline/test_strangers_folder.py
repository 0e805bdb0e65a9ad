"""A folder from a stranger: it runs no code, and nothing outside it changes."""

import re
import shlex
import subprocess

import pytest

from helpers.small_run import ROOT, SNAKEMAKE, job_environment, run_snakemake

pytestmark = [pytest.mark.pipeline, pytest.mark.slow]

CONFIG = "sessions: {s: {rig: husky, log: x.mcap}}\n"
README_COMMAND = re.compile(r"^ +(<checkout>/\.venv/bin/snakemake .*)$", re.MULTILINE)


@pytest.fixture
def folder(tmp_path):
    """A stranger's folder beside a victim's, with a config but no log."""
    home = tmp_path / "stranger"
    (home / "config").mkdir(parents=True)
    (home / "config/config.yaml").write_text(CONFIG)
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim/precious").write_text("keep")
    return home


def victim_files(folder):
    """The content of the victim's files by name."""
    return {p.name: p.read_text() for p in (folder.parent / "victim").iterdir()}


def readme_words(folder):
    """README's command for a folder, word by word."""
    (line,) = README_COMMAND.findall((ROOT / "README.md").read_text())
    checkout = shlex.quote(str(ROOT))
    words = shlex.split(line.replace("<checkout>", checkout).replace("<folder>", str(folder)))
    return [str(SNAKEMAKE), *words[1:]]


def write_profile(folder):
    """A profile that runs Python when Snakemake reads it; returns the file that this makes."""
    mark, profile = folder.parent / "profile_ran", folder / "profiles/default/config.yaml"
    profile.parent.mkdir(parents=True)
    profile.write_text(
        "__use_yte__: true\n__definitions__:\n"
        f"  - import pathlib\n  - pathlib.Path({str(mark)!r}).touch()\nkeep-going: true\n"
    )
    return mark


def run_in(folder, words):
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, env=job_environment())


def test_a_profile_of_the_folder_runs_by_snakemake_alone_and_not_by_our_command(folder):
    mark = write_profile(folder)
    ours = run_in(folder, [*readme_words(folder), "-n"])
    assert not mark.exists() and "profiles/default" in ours.stderr
    words = readme_words(folder)
    at = words.index("--workflow-profile")
    run_in(folder, [*words[:at], *words[at + 2 :], "-n"])
    assert mark.exists()  # so the profile is one that would have run


def test_make_calibrate_runs_neither_profile_nor_snakefile_of_the_folder(folder):
    mark = write_profile(folder)
    (folder / "Snakefile").write_text(f"open({str(mark)!r}, 'w')\n")
    make = run_in(ROOT, ["make", "calibrate", f"DIR={folder}", "ARGS=-n"])
    assert make.returncode != 0 and "husky.yaml: no such file" in make.stderr + make.stdout
    assert not mark.exists()


def test_a_config_that_holds_code_is_refused_before_it_runs(folder):
    mark = folder.parent / "config_ran"
    code = f"__use_yte__: true\n__definitions__:\n  - open({str(mark)!r}, 'w')\n"
    (folder / "config/config.yaml").write_text(code + CONFIG)
    run = run_snakemake(folder, "-n")
    said = run.stdout + run.stderr
    assert run.returncode == 1 and "__use_yte__ runs code of the file" in said
    assert not mark.exists() and "Traceback" not in said


@pytest.mark.parametrize(
    "link",
    [
        "results",
        "results/husky",
        "results/husky/s",
        "results/husky/export",
        "results/husky/.export.part",
        ".snakemake/locks",
        ".snakemake/metadata",
    ],
)
def test_a_link_to_a_folder_outside_stops_the_run(folder, link):
    path = folder / link
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(folder.parent / "victim")
    run = run_snakemake(folder)
    assert run.returncode == 1 and f"{link}: a symbolic link to" in run.stderr
    assert "Traceback" not in run.stderr and victim_files(folder) == {"precious": "keep"}


@pytest.mark.parametrize(
    "link", ["results/husky/s/decode.log", "results/husky/s/.log.json.part", "results/index.html"]
)
def test_a_link_to_a_file_outside_stops_the_run(folder, link):
    path = folder / link
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(folder.parent / "victim/precious")
    run = run_snakemake(folder)
    assert run.returncode == 1 and f"{link}: a symbolic link to" in run.stderr
    assert victim_files(folder) == {"precious": "keep"}
