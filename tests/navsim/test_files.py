"""Files that are there as a whole or not at all."""

import errno
import os
import stat
import threading

import pytest

from navsim.files import TEMPORARY, atomic_write, write_text


def test_what_is_written_has_its_line_ends(tmp_path):
    path = tmp_path / "file"
    write_text(path, "one\r\ntwo\né")
    assert path.read_bytes() == b"one\r\ntwo\n\xc3\xa9"
    assert os.listdir(tmp_path) == ["file"]


def test_a_directory_that_is_missing_is_made(tmp_path):
    path = tmp_path / "not" / "yet" / "there"
    with atomic_write(path, "wb") as file:
        file.write(b"\0\xff")
    assert path.read_bytes() == b"\0\xff"


@pytest.mark.parametrize("error", [OSError("full"), KeyboardInterrupt()])
def test_what_fails_on_the_way_leaves_what_was_there_and_no_trace(tmp_path, error):
    path = tmp_path / "file"
    write_text(path, "before")

    def fail():
        with atomic_write(path) as file:
            file.write("half")
            file.flush()
            (meanwhile,) = set(tmp_path.iterdir()) - {path}
            assert TEMPORARY.fullmatch(meanwhile.name)
            assert path.read_text() == "before"
            raise error

    with pytest.raises(type(error)):
        fail()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_is_full_tells_of_which_file(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*file'$"), atomic_write(tmp_path / "file") as file:
        file.write("too much")
    assert not any(tmp_path.iterdir())


def test_an_error_without_a_number_keeps_its_words(tmp_path):
    with pytest.raises(OSError, match=r"^the encoder has failed$"), atomic_write(tmp_path / "file"):
        raise OSError("the encoder has failed")


def test_a_directory_that_takes_no_files_is_told_by_the_name_of_the_file(tmp_path, monkeypatch):
    def refuse(**settings):
        raise PermissionError(errno.EACCES, "Permission denied", "a temporary name")

    monkeypatch.setattr("navsim.files.tempfile.mkstemp", refuse)
    with pytest.raises(PermissionError, match=r"Permission denied: '.*picture\.png'$"):
        write_text(tmp_path / "picture.png", "")


def test_permissions_stay_and_new_files_have_those_of_any_other(tmp_path):
    path, other = tmp_path / "file", tmp_path / "other"
    write_text(path, "new")
    other.write_text("")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)
    path.chmod(0o640)
    write_text(path, "newer")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_what_a_link_points_to_is_replaced(tmp_path):
    path, link = tmp_path / "file", tmp_path / "link"
    write_text(path, "before")
    link.symlink_to("file")
    write_text(link, "after")
    assert link.is_symlink()
    assert path.read_text() == "after"


def test_what_is_no_file_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_text(pipe, "through")
    reader.join(10.0)
    assert read == ["through"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]
    reading, writing = os.pipe()
    write_text(f"/dev/fd/{writing}", "through")
    assert os.read(reading, 20) == b"through"
    os.close(reading)
    os.close(writing)
    write_text("/dev/null", "away")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_a_file_that_is_read_only_is_not_replaced(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_text(path, "before")
    path.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda file, mode: bool(file.stat().st_mode & 0o200))  # root may write anything
    with pytest.raises(PermissionError, match=r"Permission denied: '.*file'$"):
        write_text(path, "after")
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_in_the_way_of_a_directory_is_named_behind_links_too(tmp_path):
    blocking = tmp_path / "notes"
    blocking.write_text("here")
    (tmp_path / "link").symlink_to(blocking / "deeper" / "file")
    for path in (blocking / "deeper" / "file", tmp_path / "link"):
        with pytest.raises(NotADirectoryError, match="is a file where a directory is needed") as refused:
            write_text(path, "new")
        assert refused.value.filename == str(blocking)
    assert blocking.read_text() == "here"
