"""Tracks of a video file, frame by frame, by PyAV (FFmpeg)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats.rgbd_video import InOrder, import_extra
from freeart21.formats.third_party import MAX_FRAMES
from freeart21.se3 import Array

MAX_VIDEO_BYTES = 64 << 30


class VideoFile:
    """A video file of one container format. FFmpeg reads the opened file and no other, and guesses no format.

    Raises FreeArtError when it is no such file.
    """

    def __init__(self, path: Path, container: str, root: Path | None = None):
        self.path, self._container, self._root = path, container, root
        self._av = import_extra("av", str(path))
        with self.open() as opened:
            self.metadata = dict(opened.metadata)
            self.attachments = {one.name: bytes(one.data) for one in opened.streams.attachments}
            self.titles = {one.metadata.get("title", str(one.index)): one.index for one in opened.streams.video}

    @contextlib.contextmanager
    def open(self) -> Iterator[Any]:
        """The opened container of PyAV; its errors become a FreeArtError."""
        with checked.open_file(self.path, MAX_VIDEO_BYTES, self._root) as file:
            try:
                with self._av.open(file, format=self._container) as opened:
                    yield opened
            except (self._av.FFmpegError, ValueError, IndexError) as error:
                raise FreeArtError(
                    f"{self.path} is not a readable {self._container} video: {str(error)[:120]}"
                ) from error


class VideoTrack:
    """A video track of a file. Frames are decoded in order: reading them by rising index is fast."""

    def __init__(self, file: VideoFile, index: int):
        self._file, self._index = file, index
        self._frames = InOrder(self._decode)
        with file.open() as opened:
            stream = opened.streams[index]
            self.width, self.height = int(stream.codec_context.width), int(stream.codec_context.height)
            if not 0 < self.width * self.height <= checked.MAX_PIXELS:
                raise FreeArtError(
                    f"{file.path} claims {self.width} x {self.height} pixels, at most {checked.MAX_PIXELS} are read"
                )
            stamps = []
            for packet in opened.demux(stream):
                if packet.pts is not None:
                    stamps.append(float(packet.pts * packet.time_base))
                if len(stamps) > MAX_FRAMES:
                    raise FreeArtError(f"{file.path} has more than {MAX_FRAMES} frames")
        self.times_s: Array = np.sort(np.array(stamps, float))
        """(n,) seconds."""

    def __len__(self) -> int:
        return len(self.times_s)

    def read(self, index: int, pixels: str | None = None) -> NDArray[Any]:
        """Frame `index` as FFmpeg's pixel format `pixels`, or as stored. Raises FreeArtError when it is not there."""
        frame = self._frames.read(index)
        if frame is not None and (frame.width, frame.height) == (self.width, self.height):
            return np.asarray(frame.to_ndarray() if pixels is None else frame.to_ndarray(format=pixels))
        raise FreeArtError(
            f"{self._file.path}: frame {index} of track {self._index} is missing or of another size, expected "
            f"{len(self)} frames of {self.width} x {self.height}"
        )

    def _decode(self) -> Iterator[Any]:
        with self._file.open() as opened:
            yield from opened.decode(opened.streams[self._index])
