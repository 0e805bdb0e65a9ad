"""Files are written complete or not at all, never through a link; only own files are removed."""

import errno

import pytest

from calib.io.atomic_files import (
    atomic_folder,
    atomic_write,
    create_file,
    remove_folder,
    require_no_link_below,
    write_file,
)
from calib.io.status import InputError
from calib.io.urdf.patch_urdf import patch_urdf


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A working folder beside a victim's folder with one file."""
    (tmp_path / "home/results/husky").mkdir(parents=True)
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim/precious").write_text("keep")
    monkeypatch.chdir(tmp_path / "home")
    return tmp_path / "home"


def victim_files(home):
    return {p.name: p.read_text() for p in (home.parent / "victim").iterdir()}


def test_a_part_file_that_is_a_link_is_not_followed(home):
    part = home / "results/husky/.log.json.part"
    part.symlink_to(home.parent / "victim/precious")
    write_file("results/husky/log.json", "new")
    assert (home / "results/husky/log.json").read_text() == "new" and not part.is_symlink()
    assert victim_files(home) == {"precious": "keep"}


def test_a_file_that_is_a_link_is_replaced_and_not_followed(home):
    (home / "results/husky/log.json").symlink_to(home.parent / "victim/precious")
    write_file("results/husky/log.json", "new")
    assert not (home / "results/husky/log.json").is_symlink()
    assert victim_files(home) == {"precious": "keep"}


@pytest.mark.parametrize("link", ["results", "results/husky", "results/husky/s"])
@pytest.mark.parametrize("is_absolute", [True, False])
def test_a_folder_on_the_way_that_is_a_link_is_refused(home, link, is_absolute):
    if link != "results/husky/s":
        (home / "results/husky").rmdir()
    if link == "results":
        (home / "results").rmdir()
    (home / link).symlink_to(home.parent / "victim")
    path = "results/husky/s/log.json"
    with pytest.raises(InputError, match=f"{link}: a symbolic link to .*victim"):
        write_file(home / path if is_absolute else path, "new")
    with pytest.raises(InputError, match="a symbolic link"):
        remove_folder("results/husky/s/export", lambda name: True)
    assert victim_files(home) == {"precious": "keep"}


def test_a_new_file_is_not_one_that_exists_or_a_link(home):
    (home / "link").symlink_to(home / "nowhere")
    create_file(home / "there", b"1")
    for name in ("link", "there"):
        with pytest.raises(FileExistsError):
            create_file(home / name, b"2")
    assert not (home / "nowhere").exists() and (home / "there").read_bytes() == b"1"


def test_a_part_left_by_a_killed_job_is_replaced(home):
    (home / "results/.a.part").write_text("half of an old fi")
    with atomic_write("results/a") as part:
        assert part.read_bytes() == b""
        part.write_text("new")
    assert (home / "results/a").read_text() == "new" and not part.exists()


def test_a_full_disk_leaves_nothing_behind(home):
    with (
        pytest.raises(InputError, match="no space left on the disk"),
        atomic_write("results/a"),
    ):
        raise OSError(errno.ENOSPC, "full")
    assert [p.name for p in (home / "results").iterdir()] == ["husky"]


@pytest.mark.parametrize("folder", ["export", ".export.part"])
@pytest.mark.parametrize("foreign", ["notes.txt", "sub/notes.txt", "link"])
def test_a_folder_with_files_of_others_is_not_removed(home, folder, foreign):
    path = home / "results/husky" / folder / foreign
    path.parent.mkdir(parents=True)
    own = home / "results/husky" / folder / "a.yaml"
    own.write_text("own")
    if foreign == "link":
        path.symlink_to(home.parent / "victim")
    else:
        path.write_text("mine")
    with pytest.raises(InputError, match=f"{foreign}: not written by this pipeline"):
        remove_folder("results/husky/export", lambda name: name.endswith(".yaml"))
    assert own.exists() and (path.is_symlink() or path.read_text() == "mine")
    assert victim_files(home) == {"precious": "keep"}


def test_a_folder_of_own_files_is_replaced(home):
    old = home / "results/husky/export/koide3/a.yaml"
    old.parent.mkdir(parents=True)
    old.write_text("old")
    with atomic_folder("results/husky/export", lambda name: name.endswith(".yaml")) as folder:
        create_file(folder / "b.yaml", b"new")
    assert [p.name for p in (home / "results/husky/export").rglob("*")] == ["b.yaml"]
    assert [p.name for p in (home / "results/husky").iterdir()] == ["export"]


def test_an_export_folder_that_is_a_link_is_refused(home):
    (home / "results/husky/export").symlink_to(home.parent / "victim")
    with pytest.raises(InputError, match="export: a symbolic link"):
        remove_folder("results/husky/export", lambda name: True)
    assert victim_files(home) == {"precious": "keep"}


def test_links_are_found_at_any_depth(home):
    (home / "results/husky/s").mkdir()
    require_no_link_below("results")
    require_no_link_below("no such folder")
    (home / "results/husky/s/decode.log").symlink_to("/dev/null")
    with pytest.raises(InputError, match=r"results/husky/s/decode\.log: a symbolic link"):
        require_no_link_below("results")


def test_a_urdf_behind_a_link_is_not_changed(home):
    (home.parent / "victim/robot.urdf").write_text("<robot/>")
    (home / "robot.urdf").symlink_to(home.parent / "victim/robot.urdf")
    (home / "sub").symlink_to(home.parent / "victim")
    for path in ("robot.urdf", "sub/robot.urdf"):
        with pytest.raises(InputError, match="a symbolic link"):
            patch_urdf(home / path, [], "base_link")
    assert victim_files(home)["robot.urdf"] == "<robot/>"
