"""Writes pictures while the renderer draws: they are encoded in threads."""

from __future__ import annotations

import os
import threading
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any

from numpy.typing import NDArray

from freeart21.files import atomic, checked


class FrameWriter:
    """A context manager: `put` pictures into it; all of them are on disk when it ends, unless one could not be written.

    The simulator holds Python's global lock while it draws, and a thread that wants the lock waits for a whole picture.
    So a thread only encodes, which needs no lock; `put` returns when the encoding has started; and the caller's thread
    writes the encoded files. Memory is bounded: `put` waits when all threads are busy.
    """

    def __init__(self, threads: int | None = None) -> None:
        """`threads` that encode; None takes the number of cores, at least 4 and at most 16."""
        self._pool = ThreadPoolExecutor(threads or min(max(4, os.cpu_count() or 1), 16), "png")
        self._encoding = threading.Semaphore(0)
        self._waiting: deque[list[tuple[Path, Future[bytes]]]] = deque()

    def put(self, pictures: dict[Path, NDArray[Any]]) -> None:
        """Encode `pictures` as PNG, each to be written to its path, whole or not at all.

        The arrays must not change afterwards. Raises FreeArtError when an earlier picture could not be written.
        """
        while self._waiting and all(future.done() for _, future in self._waiting[0]):
            self._write_oldest()
        self._waiting.append([(path, self._pool.submit(self._encode, image)) for path, image in pictures.items()])
        for _ in pictures:
            self._encoding.acquire()

    def _encode(self, image: NDArray[Any]) -> bytes:
        self._encoding.release()
        return checked.encode_png(image)

    def _write_oldest(self) -> None:
        for path, future in self._waiting.popleft():
            atomic.write_bytes(path, future.result(), sync=False)

    def __enter__(self) -> FrameWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            while self._waiting and not isinstance(error, Exception):  # also when interrupted: what is drawn is kept
                self._write_oldest()
        finally:
            self._pool.shutdown(cancel_futures=True)
