"""What an archive of results must not hold."""

import stat
import struct
import zipfile

import pytest

from freeart21.errors import FreeArtError
from leaderboard import archive
from leaderboard.archive import open_results


@pytest.fixture
def packed(tmp_path):
    """Makes an archive of (name or ZipInfo, bytes)."""

    def make(*entries, name="results.zip"):
        with zipfile.ZipFile(tmp_path / name, "w", zipfile.ZIP_DEFLATED) as made:
            for entry, data in entries:
                made.writestr(entry, data)
        return tmp_path / name

    return make


@pytest.mark.parametrize("top", ["", "mine/"])
def test_an_archive_holds_results_or_one_folder_of_them(packed, top):
    path = packed((f"{top}a/prediction.json", "{}"), (f"{top}b/prediction.json", "[]"), ("__MACOSX/._a", "x"))
    with open_results(path) as folder:
        assert sorted(p.name for p in folder.iterdir()) == ["a", "b"] and folder.name == ("mine" if top else "results")
        assert (folder / "b" / "prediction.json").read_text() == "[]"
        aside = folder
    assert not aside.exists()


def test_one_answer_is_not_taken_for_the_folder_of_all(packed):
    with open_results(packed(("a/prediction.json", "{}"))) as folder:
        assert (folder / "a" / "prediction.json").exists()


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/../../x", "a\\..\\x", "a\nb"])
def test_entries_that_lead_elsewhere_are_refused_before_anything_is_unpacked(packed, monkeypatch, name):
    monkeypatch.setattr(zipfile.ZipFile, "extractall", lambda *_: pytest.fail("unpacked"))
    with (
        pytest.raises(FreeArtError, match="is no plain path") as error,
        open_results(packed(("a/b", "x"), (name, "x"))),
    ):
        pass
    assert str(error.value).isprintable()


def test_a_link_is_unpacked_as_a_plain_file(packed):
    link = zipfile.ZipInfo("a/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with open_results(packed(("b", "x"), (link, "/etc/passwd"))) as folder:
        assert not (folder / "a/link").is_symlink() and (folder / "a/link").read_text() == "/etc/passwd"


def test_bombs_are_refused(packed, monkeypatch):
    many = packed(("a", bytes(900)), ("b", bytes(900)))
    with monkeypatch.context() as few:
        few.setattr(archive, "MAX_ARCHIVE_BYTES", 1500)
        with pytest.raises(FreeArtError, match="unpacks to 1800 bytes"), open_results(many):
            pass
    monkeypatch.setattr(archive, "MAX_FILES", 1)
    with pytest.raises(FreeArtError, match="has 2 entries"), open_results(many):
        pass
    monkeypatch.setattr(archive, "MAX_DIRECTORY_BYTES", 50)
    with pytest.raises(FreeArtError, match="directory of 9"), open_results(many):
        pass


def test_an_entry_with_more_bytes_than_it_says_is_refused(packed):
    path = packed(("a", bytes(5000)))
    data = bytearray(path.read_bytes())
    for at, field in ((data.find(b"PK\3\4"), 22), (data.rfind(b"PK\1\2"), 24)):
        data[at + field : at + field + 4] = struct.pack("<I", 10)
    path.write_bytes(data)
    with pytest.raises(FreeArtError, match=r"more bytes than it says|cannot be unpacked"), open_results(path):
        pass


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\5\6" + bytes(18), b"garbage" * 100])
def test_what_is_no_archive_is_one_clear_line(tmp_path, content):
    path = tmp_path / "results.zip"
    path.write_bytes(content)
    try:
        with open_results(path) as folder:
            assert not any(folder.iterdir())  # an empty archive is an empty folder of results
    except FreeArtError as error:
        assert "cannot be unpacked" in str(error) and str(error).isprintable()


def test_another_file_is_named(tmp_path):
    (tmp_path / "x.tar").write_bytes(b"x")
    with (
        pytest.raises(FreeArtError, match=r"expected a folder of results or a \.zip"),
        open_results(tmp_path / "x.tar"),
    ):
        pass
