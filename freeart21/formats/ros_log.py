"""A recording of ROS messages: an Intel RealSense's .bag, a camera driver's ROS 1 .bag or ROS 2 .mcap.

Read are Image, CompressedImage (also compressedDepth), CameraInfo, and the transform from depth to colours:
RealSense's `tf` topics map the reference stream to each stream (librealsense, ros_writer.cpp), a driver's /tf_static
the child frame to its parent. 16-bit depth is in millimetres, or in RealSense's Depth_Units; 32-bit depth in metres.
The types are those of ROS: no definition of the file is used. Infrared pictures are left out.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.rgbd_video import (
    InOrder,
    Lens,
    Picture,
    RgbdVideo,
    align_video,
    fit_forward_distortion,
    import_extra,
    intrinsics,
    pair_streams,
)
from freeart21.formats.third_party import (
    MAX_FRAMES,
    ReadOptions,
    RecordingLayout,
    ThirdPartyRecording,
)
from freeart21.se3 import Array

MAX_LOG_BYTES = 1 << 40
MAX_CHUNK_BYTES = 256 << 20
"""Of a chunk, unpacked: writers close one at some megabytes."""
_PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_INFO, _TRANSFORM, _TREE = "sensor_msgs/msg/CameraInfo", "geometry_msgs/msg/Transform", "tf2_msgs/msg/TFMessage"
_UNIT = "std_msgs/msg/Float32"
_KINDS = (*_PICTURES, _INFO, _TRANSFORM, _TREE, _UNIT)
_DEPTH_ENCODINGS = {"16uc1": np.uint16, "mono16": np.uint16, "z16": np.uint16, "32fc1": np.float32}
_COLOUR_ENCODINGS = {"rgb8": None, "bgr8": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_RGBA2RGB, "bgra8": cv2.COLOR_BGRA2RGB}
_FORWARD = ("plumb bob", "rational polynomial", "brown conrady")
_INVERSE = "inverse brown conrady"
Message = tuple[str, str, int, Any]
"""Topic, type, nanoseconds, and the message of rosbags."""


def read_ros_log(source: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in the file `source`. Raises FreeArtError in one line."""
    source = Path(source)
    seen = _Contents(source)
    colour, depth = seen.find_colours(), seen.find_depth()
    lens = seen.read_lens(colour)
    aligned = "aligned" in depth or seen.frames[depth] == seen.frames[colour] != ""
    T = np.eye(4) if aligned else seen.find_transform(colour, depth)
    colour_s, depth_s = (np.array(seen.times_ns[topic], float) / 1e9 for topic in (colour, depth))
    colours, depths, times, notes = pair_streams(source, colour_s, depth_s)
    colour_of, depth_of = (InOrder(partial(read_messages, source, topic)) for topic in (colour, depth))

    def load(index: int) -> Picture:
        rgb = _decode_colours(colour_of.read(int(colours[index]))[3], f"{source}: {colour}")
        raw = _decode_depth(depth_of.read(int(depths[index]))[3], f"{source}: {depth}")
        if raw.dtype == np.uint16:
            raw = np.where(raw < 65535, raw, 0).astype(np.float32) * np.float32(seen.depth_unit)
        return Picture(rgb, raw.astype(np.float32))

    video = RgbdVideo(
        third_party.safe_name(source.resolve().stem),
        times,
        load,
        lens,
        None if aligned else seen.read_lens(depth),
        T,
        notes=(f"colours are {colour}, depth is {depth}", *notes),
    )
    return align_video(video, options)


class _Contents:
    """What a log holds, read once."""

    def __init__(self, source: Path):
        self.source, self.depth_unit = source, 1e-3
        self.times_ns: dict[str, list[int]] = {}
        self.frames: dict[str, str] = {}
        self.kinds: dict[str, str] = {}
        self.infos: dict[str, Any] = {}
        self.transforms: dict[str, Array] = {}
        self.tree: dict[tuple[str, str], Array] = {}
        for topic, kind, time_ns, message in read_messages(source):
            if kind in _PICTURES:
                stamp = message.header.stamp
                own = int(stamp.sec) * 10**9 + int(stamp.nanosec)
                self.times_ns.setdefault(topic, []).append(own or time_ns)
                self.frames.setdefault(topic, message.header.frame_id.strip("/"))
                self.kinds.setdefault(topic, (message.encoding if kind == _PICTURES[0] else message.format).lower())
                if len(self.times_ns[topic]) > MAX_FRAMES:
                    raise FreeArtError(f"{source}: {topic} has more than {MAX_FRAMES} pictures")
            elif kind == _INFO:
                self.infos.setdefault(topic, message)
            elif kind == _TRANSFORM:
                self.transforms[topic] = _pose(message)
            elif kind == _TREE:
                for one in message.transforms[: 1 << 10]:
                    ends = (one.header.frame_id.strip("/"), one.child_frame_id.strip("/"))
                    self.tree[ends] = _pose(one.transform)
            elif kind == _UNIT and topic.lower().replace(" ", "_").endswith("depth_units/value"):
                self.depth_unit = float(message.data)
        if not 0 < self.depth_unit < 1:
            raise FreeArtError(f"{source}: Depth_Units is {self.depth_unit!r}, expected metres between 0 and 1")

    def find_colours(self) -> str:
        """The topic of the colours."""
        bright = [
            topic
            for topic, kind in self.kinds.items()
            if (kind in _COLOUR_ENCODINGS or "jpeg" in kind or "png" in kind)
            and not any(word in topic.lower() for word in ("depth", "infra", "/ir/"))
        ]
        return self._best(bright, ("color", "colour", "rgb"), "colours (rgb8, bgr8, rgba8, bgra8 or compressed)")

    def find_depth(self) -> str:
        """The topic of the depth; that which is aligned to the colours, if there is one."""
        deep = [
            topic
            for topic, kind in self.kinds.items()
            if "depth" in topic.lower() and (kind in _DEPTH_ENCODINGS or "compresseddepth" in kind)
        ]
        return self._best(deep, ("aligned",), "depth (16UC1 or 32FC1)")

    def _best(self, topics: list[str], words: tuple[str, ...], what: str) -> str:
        if not topics:
            held = ", ".join(f"{topic} ({kind})" for topic, kind in self.kinds.items()) or "no pictures"
            raise FreeArtError(f"{self.source} has no {what}; it has {held[:300]}")
        return min(topics, key=lambda topic: (not any(word in topic.lower() for word in words), topic))

    def read_lens(self, topic: str) -> Lens:
        """The camera of the pictures of `topic`: the CameraInfo whose topic begins most like it."""
        parts = topic.split("/")

        def shared(other: str) -> int:
            same = [a == b for a, b in zip(parts, other.split("/"), strict=False)]
            return same.index(False) if False in same else len(same)

        if not self.infos:
            raise FreeArtError(f"{self.source} has no CameraInfo: its intrinsic matrix is unknown")
        name = max(self.infos, key=shared)
        info, where = self.infos[name], f"{self.source}: {name}"
        K = np.asarray(info.K if hasattr(info, "K") else info.k, float).reshape(3, 3)
        D = np.asarray(info.D if hasattr(info, "D") else info.d, float)
        if (
            not np.isfinite(K).all()
            or not np.isfinite(D).all()
            or not 0 < info.width * info.height <= checked.MAX_PIXELS
        ):
            raise FreeArtError(f"{where} has K {K.tolist()} and D {D.tolist()} for {info.width} x {info.height} pixels")
        lens = Lens(intrinsics((K[0, 0], K[1, 1], K[0, 2], K[1, 2])), int(info.width), int(info.height))
        model = info.distortion_model.lower().replace("_", " ").strip()
        if not D.any():
            return lens
        if model == _INVERSE and len(D) == 5:
            return fit_forward_distortion(lens, D, where)
        if model not in _FORWARD or len(D) not in (4, 5, 8):
            raise FreeArtError(f"{where}: distortion '{model[:40]}' with {len(D)} numbers is not known")
        return Lens(lens.K, lens.width, lens.height, D)

    def find_transform(self, colour: str, depth: str) -> Array:
        """T_colour_depth (4, 4), by RealSense's topics or by the tree of frames."""
        own = [
            next((T for name, T in self.transforms.items() if name.startswith(f"{_stream(topic)}/tf")), None)
            for topic in (colour, depth)
        ]
        if own[0] is not None and own[1] is not None:
            return own[0] @ se3.inverse(own[1])
        reached = {self.frames[depth]: np.eye(4)}  # frame to T_frame_depth
        edges = [*self.tree.items(), *(((b, a), se3.inverse(T)) for (a, b), T in self.tree.items())]
        for _ in range(len(self.tree)):
            for (to, start), T in edges:
                if start in reached and to not in reached:
                    reached[to] = T @ reached[start]
        if self.frames[colour] not in reached:
            ends = f"{self.frames[depth] or depth} to {self.frames[colour] or colour}"
            raise FreeArtError(
                f"{self.source} has no transform from {ends}: record /tf_static, or depth aligned to the colours"
            )
        return reached[self.frames[colour]]


def read_messages(source: Path, topic: str | None = None) -> Iterator[Message]:
    """The messages of the types read here, by time; of `topic` alone when it is given."""
    checked.require_file(source, MAX_LOG_BYTES, checked.ANYWHERE)
    typesys = import_extra("rosbags.typesys", str(source))
    bags, logs = import_extra("rosbags.rosbag1", str(source)), import_extra("rosbags.rosbag2", str(source))
    is_bag = source.suffix.lower() == ".bag"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_bag else typesys.Stores.ROS2_HUMBLE)
    if _TREE not in store.types:
        store.register(typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TREE))
    decode = store.deserialize_ros1 if is_bag else store.deserialize_cdr
    lz4 = import_extra("lz4.frame", str(source)).LZ4FrameDecompressor
    bags.reader.decompressors.update(bz2=_bounded(bz2.BZ2Decompressor), lz4=_bounded(lz4))
    mcap = import_extra("rosbags.rosbag2.storage_mcap", str(source))
    mcap.DECOMPRESSORS.update(lz4=_bounded(lz4), zstd=_bounded(mcap.zstd.ZstdDecompressor))
    try:
        with (bags if is_bag else logs).Reader(source) as reader:
            known = [one for one in reader.connections if one.msgtype in _KINDS and topic in (None, one.topic)]
            for one, time_ns, data in reader.messages(known) if known else ():
                yield one.topic, one.msgtype, time_ns, decode(data, one.msgtype)
    except Exception as error:  # the library raises what it likes on broken files
        raise FreeArtError(f"{source} is not a readable log: {type(error).__name__} {str(error)[:120]}") from error


def _bounded(unpacker: Callable[[], Any]) -> Callable[..., bytes]:
    """A function of packed bytes that unpacks at most MAX_CHUNK_BYTES: the library's own have no limit."""

    def unpack(data: bytes, size: int = 0) -> bytes:
        found: bytes = unpacker().decompress(data, MAX_CHUNK_BYTES + 1)
        if len(found) > MAX_CHUNK_BYTES:
            raise ValueError(f"a chunk unpacks to more than {MAX_CHUNK_BYTES} bytes")
        return found

    return unpack


def _decode_depth(message: Any, where: str) -> NDArray[Any]:
    """(rows, columns) uint16, or float32 metres."""
    if hasattr(message, "format"):  # compressedDepth: 12 bytes of settings, then a PNG
        return checked.decode_image(bytes(message.data[12:]), Path(where), cv2.IMREAD_UNCHANGED)
    return _rows(message, np.dtype(_DEPTH_ENCODINGS[message.encoding.lower()]), 1, where)[..., 0]


def _decode_colours(message: Any, where: str) -> NDArray[np.uint8]:
    """(height, width, 3) RGB."""
    if hasattr(message, "format"):
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        return np.ascontiguousarray(checked.decode_image(bytes(message.data), Path(where), flags)[..., ::-1])
    encoding = message.encoding.lower()
    pixels = _rows(message, np.dtype(np.uint8), 4 if "a" in encoding else 3, where)
    code = _COLOUR_ENCODINGS[encoding]
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code))


def _rows(message: Any, kind: np.dtype[Any], channels: int, where: str) -> NDArray[Any]:
    """(height, width, channels) of an Image, whose rows are `step` bytes apart."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    size = width * channels * kind.itemsize
    if not 0 < height * width <= checked.MAX_PIXELS or step < size or len(message.data) < step * height:
        raise FreeArtError(
            f"{where}: a picture of {width} x {height}, {step} bytes a row, has {len(message.data)} bytes"
        )
    rows = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)[:, :size]
    order = kind.newbyteorder(">" if message.is_bigendian else "<")
    return np.ascontiguousarray(rows).view(order).astype(kind).reshape(height, width, channels)


def _stream(topic: str) -> str:
    """RealSense's stream of a topic: /device_0/sensor_0/Depth_0 of /device_0/sensor_0/Depth_0/image/data."""
    return topic.removesuffix("/data").removesuffix("/image")


def _pose(transform: Any) -> Array:
    """(4, 4) of a Transform message."""
    t, q = transform.translation, transform.rotation
    wxyz = np.array([q.w, q.x, q.y, q.z])
    return third_party.poses_from_rows(np.array([[t.x, t.y, t.z, *wxyz]]), "a transform")[0]


LAYOUT = RecordingLayout(
    "ros",
    1,
    "a .bag file of a RealSense or ROS 1, or an .mcap file of ROS 2",
    lambda path: path.is_file() and path.suffix.lower() in (".bag", ".mcap"),
    read_ros_log,
)
