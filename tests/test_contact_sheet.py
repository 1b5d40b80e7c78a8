"""The contact sheet shows every object in three poses, from views that tell something."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from freeart21 import catalog
from freeart21.errors import FreeArtError
from generator import contact_sheet

NAMES, TILE = ("drawer_unit", "stapler"), 72


def _drawn_pixels(tile: np.ndarray) -> np.ndarray:
    """(h, w) pixels that are not white."""
    return (tile < 245).any(-1)


@pytest.fixture(scope="module")
def pictures() -> dict[str, list[np.ndarray]]:
    return {name: contact_sheet.tiles(name, 2, TILE, "trivial") for name in NAMES}


def test_every_tile_shows_its_object_whole_and_large(pictures: dict[str, list[np.ndarray]]) -> None:
    for name in NAMES:
        assert len(pictures[name]) == 3
        for tile in pictures[name]:
            shown = _drawn_pixels(tile)
            assert shown.shape == (TILE, TILE)
            assert not (shown[0].any() or shown[-1].any() or shown[:, 0].any() or shown[:, -1].any())
            rows, columns = np.flatnonzero(shown.any(1)), np.flatnonzero(shown.any(0))
            spans = np.array([np.ptp(rows), np.ptp(columns)])
            assert 0.84 * TILE < spans.max() < 0.94 * TILE
            assert abs(rows[0] + rows[-1] + 1 - TILE) < 5 and abs(columns[0] + columns[-1] + 1 - TILE) < 5


def test_the_poses_differ_even_from_one_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(contact_sheet.VIEWS, "drawer_unit", ((-35, 20),) * 3)
    tiles = contact_sheet.tiles("drawer_unit", 2, TILE, "trivial")
    for a, b in ((0, 1), (1, 2)):
        assert (np.abs(tiles[a].astype(int) - tiles[b]).max(-1) > 30).mean() > 0.1


def test_the_sheet_holds_a_card_an_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pictures: dict[str, list[np.ndarray]]
) -> None:
    monkeypatch.setattr(contact_sheet, "tiles", lambda name, *_: pictures[name])
    contact_sheet.contact_sheet((*NAMES, NAMES[0]), tmp_path / "sheet.png", 2, TILE, columns=2, shader="trivial")
    sheet = cv2.imread(str(tmp_path / "sheet.png"))[..., ::-1]
    wide, high = 3 * TILE + 2, TILE + 30
    assert sheet.shape == (2 * high + 30, 2 * wide + 30, 3)
    for k, name in enumerate((*NAMES, NAMES[0])):
        y, x = 10 + k // 2 * (high + 10), 10 + k % 2 * (wide + 10)
        assert _drawn_pixels(sheet[y + 2 : y + 28, x + 2 : x + wide - 2]).any(), "no caption"
        card = sheet[y + 29 : y + high - 1, x + 1 : x + wide - 1]
        assert np.abs(card.astype(int) - np.hstack(pictures[name])).mean() < 4
    assert not _drawn_pixels(sheet[10 + high + 10 :, 10 + wide + 10 :]).any()


def test_views_are_of_objects_of_the_catalog() -> None:
    assert set(contact_sheet.VIEWS) <= set(catalog.built_in_names())


def test_unknown_and_no_objects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FreeArtError, match="unknown object 'teapot'"):
        contact_sheet.contact_sheet(["teapot"], tmp_path / "sheet.png")
    with pytest.raises(FreeArtError, match="at least one object"):
        contact_sheet.contact_sheet([], tmp_path / "sheet.png")
    assert not list(tmp_path.iterdir())
