"""Reads `.relight` assets into numpy arrays, as FORMAT.md describes them; README.md has an example.

Bytes are untrusted: whatever is wrong raises `Invalid`, before memory is asked for that the
file does not justify. Values are as stored: radians, metres, linear Rec.709.
"""
import json
import struct
import zlib
from collections import namedtuple

import numpy as np
import zstandard

KINDS = {1: "scene", 2: "environment", 3: "material"}
SECTIONS = dict(enumerate("metadata vertices triangles clusters coefficients basis texels lobes prefiltered"
                          " sources source_texels transfer second_uvs".split(), 1))
NEEDED = {"scene": {1, 2, 3, 4, 5, 6, 7}, "environment": {1, 8, 9, 10, 11}, "material": {1, 7}}
VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("tangent", "<f4", 4), ("uv", "<f4", 2)])
TRIANGLE = np.dtype([("vertices", "<u4", 3), ("material", "<u2"), ("cluster", "<u2")])
CLUSTER = np.dtype(list(zip("first_vertex vertices first_coefficient first_tile tiles scale".split(),
                            5 * ["<u4"] + ["<f4"])))
SOURCE = np.dtype(list(zip("theta phi row_step column_step rows columns".split(), 4 * ["<f4"] + 2 * ["<u4"])))
LOBE = np.dtype([("axis", "<f4", 3), ("sharpness", "<f4"), ("amplitude", "<f4", 3), ("reserved", "<u4")])
Asset = namedtuple("Asset", "kind version metadata arrays")

class Invalid(ValueError):
    """The bytes are not a valid asset."""

def _require(holds, message):
    if not holds:
        raise Invalid(message)

def _metadata(data):
    """One JSON object; what readers of arrays need of it is checked where they do."""
    try:
        value = json.loads(data.decode(), parse_constant=lambda name: _require(False, name))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise Invalid(f"metadata: {error}") from error
    _require(isinstance(value, dict), "metadata: not an object")
    return value

def _whole(fields, *path):
    """A whole number of metadata, 1 to 2^32 - 1."""
    for name in path:
        fields = fields.get(name) if isinstance(fields, dict) else None
    _require(type(fields) is int and 0 < fields < 1 << 32, f"metadata: {'.'.join(path)}")
    return fields

def _planes(data, width):
    """Little-endian numbers whose bytes lie in planes, the lowest first."""
    _require(len(data) % width == 0, "planes of unequal length")
    planes = np.frombuffer(data, np.uint8).reshape(width, -1)
    return np.ascontiguousarray(planes.T).view(f"<u{width}").ravel()

def _signed(held):
    """Signed differences as they are held: 2d, or -2d - 1."""
    return (held >> 1).astype(np.int64) ^ -(held & 1).astype(np.int64)

def _triangles(data):
    _require(len(data) % 16 == 0, "triangles of a fraction")
    held = _planes(data, 4).reshape(4, -1)
    corners, following = [], 0
    for difference in held[:3].T.ravel().tolist():
        corners.append((following - difference) & 0xFFFFFFFF)
        following = max(following, corners[-1] + 1)
    triangles = np.zeros(held.shape[1], TRIANGLE)
    triangles["vertices"] = np.reshape(corners, (-1, 3))
    triangles["material"] = np.cumsum(held[3] & 0xFFFF, dtype=np.uint64) & 0xFFFF
    triangles["cluster"] = np.cumsum(held[3] >> 16, dtype=np.uint64) & 0xFFFF
    return triangles

def _expected(triangles, count):
    """Three places (or vertices) for each: it is expected to be the first two's sum less the third."""
    parents = np.repeat(np.arange(-1, count - 1, dtype=np.int64).clip(0)[:, None], 3, axis=1)
    known, latest = np.zeros(count, bool), {}
    for corners in triangles.tolist():
        for place, vertex in enumerate(corners):
            a, b = corners[(place + 1) % 3], corners[(place + 2) % 3]
            if not known[vertex] and vertex > a and vertex > b:
                known[vertex] = True
                others = (latest.get(end, ()) for end in (a, b))
                across = (next((c for c in other if c not in (a, b)), vertex) for other in others
                          if a in other and b in other)
                parents[vertex] = a, b, next((c for c in across if c < vertex), a)
        latest.update(dict.fromkeys(corners, corners))
    return parents

def _add_up(differences, parents, modulus):
    """Adds what is expected, vertex after vertex; vertices that are not earlier count as 0."""
    values = differences.astype(np.int64)
    for vertex, (a, b, c) in enumerate(parents.tolist()):
        for sign, parent in ((1, a), (1, b), (-1, c)):
            values[vertex] += sign * values[parent] if 0 <= parent < vertex else 0
        values[vertex] %= modulus
    return values

def _ordered(numbers):
    """Bits of float32, those below the sign inverted if it is set; or back."""
    words = np.ascontiguousarray(numbers).view("<u4")
    return np.where(words >> 31 != 0, words ^ np.uint32(0x7FFFFFFF), words).astype("<u4")

def _column(differences, exponent, parents, exact):
    """Numbers from their differences from what is expected: `exact`, or what `parents` say."""
    if exact is None:
        integers = _add_up(differences, parents, 1 << 32)
    else:
        exact = np.where(np.isnan(exact), 0.0, exact)
        exact = _ordered(exact.astype("<f4")).view("<i4") if exponent == -128 else np.rint(np.ldexp(exact, -exponent))
        integers = (exact.astype(np.int64) + differences) % (1 << 32)
    words = integers.astype("<u4")
    scaled = np.ldexp(words.view("<i4").astype(np.float64), exponent).astype("<f4")
    return _ordered(words).view("<f4") if exponent == -128 else scaled

def _vertices(data, triangles, count):
    """Vertices, the place of each, and what places and vertices are expected from."""
    _require(len(data) >= 13 + 4 * count and data[12] < 4, "vertices end early, or their modes")
    exponents, mode = np.frombuffer(data[:12], np.int8).tolist(), data[12]
    codes = _planes(data[13:13 + 4 * count], 4).astype(np.int64)
    following = np.cumsum(codes == 0) - (codes == 0)
    places, new = following - codes, int((codes == 0).sum())
    _require((places >= 0).all() and len(data) == 13 + 4 * (10 * count + 3 * new), "places of vertices")
    _require(len(triangles) == 0 or int(triangles["vertices"].max()) < count, "a triangle of other vertices")
    corners = triangles["vertices"].astype(np.int64)
    of_places, of_vertices = _expected(places[corners], new), _expected(corners, count)
    split = 13 + 4 * count + 12 * new
    at_places = _signed(_planes(data[13 + 4 * count:split], 4)).reshape(3, new)
    others = _signed(_planes(data[split:], 4)).reshape(9, count)
    numbers, exact = np.zeros((count, 12), "<f4"), [None] * 9
    for column in range(3):
        numbers[:, column] = _column(at_places[column], exponents[column], of_places, None)[places]
    with np.errstate(all="ignore"):
        if mode & 1:
            first = np.full(count, -1)
            first[corners[::-1].ravel()] = np.repeat(np.arange(len(corners))[::-1], 3)
            a, b, c = np.moveaxis(numbers[:, :3].astype(np.float64)[corners], 1, 0)
            n = np.cross(b - a, c - a)
            length = np.sqrt(n[:, 0] * n[:, 0] + n[:, 1] * n[:, 1] + n[:, 2] * n[:, 2])
            exact[:3] = np.append(n / length[:, None], np.zeros((1, 3)), axis=0)[first].T
        for column in range(9):
            if column == 3 and mode & 2:
                x, z = numbers[:, 3].astype(np.float64), numbers[:, 5].astype(np.float64)
                l = np.sqrt(x * x + z * z)
                exact[3:6] = np.where(l > 0, [z / l, 0 * l, -x / l], [[1.0], [0.0], [0.0]])
            numbers[:, 3 + column] = _column(others[column], exponents[3 + column], of_vertices, exact[column])
    return numbers.view(VERTEX).ravel(), places, of_places, of_vertices

def _second_uvs(data, parents):
    _require(0 < len(parents) and len(data) == 2 + 8 * len(parents), "length of second texture coordinates")
    columns = zip(_signed(_planes(data[2:], 4)).reshape(2, -1), np.frombuffer(data[:2], np.int8).tolist())
    return np.stack([_column(own, exponent, parents, None) for own, exponent in columns], axis=1)

def _coefficients(data, clusters, places, parents):
    channels, counts = 4 * clusters["tiles"].astype(np.int64), clusters["vertices"].astype(np.int64)
    ends = np.searchsorted(np.maximum.accumulate(places), np.arange(int(places.max(initial=-1)) + 2))
    begins = np.searchsorted(ends, np.append(0, np.cumsum(counts)))
    images, own = int(channels.sum()), np.diff(begins)
    _require(len(data) == 2 * (images + int((channels * own).sum())), "coefficients of other clusters")
    steps = _planes(data[:2 * images], 2).astype(np.int64)
    differences = _signed(_planes(data[2 * images:], 2).astype(np.uint32))
    parts, image, at, vertex = [np.zeros(0, np.int64)], 0, 0, 0
    for width, number, count, first in zip(channels.tolist(), own.tolist(), counts.tolist(), begins.tolist()):
        part = differences[at:at + width * number].reshape(width, number).T * steps[image:image + width]
        values = _add_up(part, parents[first:first + number] - first, 1 << 16)
        mine = places[vertex:vertex + count] - first
        _require(((0 <= mine) & (mine < number)).all(), "a vertex at a place of another cluster")
        parts.append(values[mine].ravel())
        image, at, vertex = image + width, at + width * number, vertex + count
    values = np.concatenate(parts)
    _require(not (values == 0x8000).any(), "a coefficient of -32768")
    return values.astype("<u2").view("<i2")

def _basis(data, n):
    """Tiles of n x n RGBA texels; all images are added up side by side."""
    _require(2 <= n <= 1024 and len(data) % (4 * n * n) == 0, "basis: a fraction of a tile")
    left = np.frombuffer(data, np.int8).reshape(-1, n, n).astype(np.int32)
    image = np.zeros_like(left)
    for y, x in np.ndindex(n, n):
        l = image[:, y, x - 1] if x else image[:, y - 1, 0]  # the first texel's is 0 still
        a = image[:, y - 1, x] if y else l
        c = l if not y else image[:, y - 1, x - 1] if x else a
        r = image[:, y - 1, x + 1] if y and x + 1 < n else a
        ll, aa = image[:, y, x - 2] if x > 1 else l, image[:, y - 2, x] if y > 1 else a
        predicted = np.clip((12 * l + 6 * a + 6 * r - c - 2 * ll - 5 * aa + 8) >> 4, -127, 127)
        image[:, y, x] = (left[:, y, x] + predicted + 128) % 256 - 128
    _require(not (image == -128).any(), "a basis texel of -128")
    return np.ascontiguousarray(image.astype(np.int8).reshape(-1, 4, n, n).transpose(0, 2, 3, 1))

def _texels(data, width, height):
    """A texture of a flag and planes; what is predicted is added along diagonals, each from the two before it."""
    left, image = data[1:].reshape(4, height, width).astype(np.int16), np.zeros((4, height + 1, width + 1), np.int16)
    left[::2] += data[0] * left[1]
    for d in range(width + height - 1):
        y = np.arange(max(0, d - width + 1), min(height, d + 1))
        l, a, c = image[:, y + 1, d - y], image[:, y, d - y + 1], image[:, y, d - y]
        image[:, y + 1, d - y + 1] = left[:, y, d - y] + np.clip(l + a - c, np.minimum(l, a), np.maximum(l, a)) & 255
    return np.ascontiguousarray(image[:, 1:, 1:].astype(np.uint8).transpose(1, 2, 0))

def _decompressed(content, length, name):
    """Exactly one Zstandard frame of exactly this length; a bomb is noticed before it has grown."""
    stream, parts, size = zstandard.ZstdDecompressor(max_window_size=8 << 20).decompressobj(), [], 0
    try:
        for start in range(0, len(content), 256):
            _require(not stream.eof, f"section {name} goes on after its end")
            parts.append(stream.decompress(content[start:start + 256]))
            size += len(parts[-1])
            _require(size <= length, f"section {name} is longer than it says")
    except zstandard.ZstdError as error:
        raise Invalid(f"section {name}: {error}") from error
    _require(stream.eof and not stream.unused_data and size == length, f"length of section {name}")
    return b"".join(parts)

def _sections(data, max_bytes):
    _require(len(data) >= 24 and data[:8] == b"RELIGHT\n", "no .relight file")
    version, kind, count, reserved = struct.unpack_from("<4I", data, 8)
    _require(4 <= version <= 5 and kind in KINDS and reserved == 0, f"version {version}, kind {kind}; this reads 4, 5")
    _require(count <= 64 and len(data) >= 24 + 32 * count, "the section table ends early")
    offset, last, total, raw = 24 + 32 * count, 0, 0, {}
    for index in range(count):
        number, checksum, start, stored, length = struct.unpack_from("<2I3Q", data, 24 + 32 * index)
        _require(number in SECTIONS and number > last, f"section {number} out of order")
        _require(start == offset and start + stored <= len(data), f"section {SECTIONS[number]} elsewhere")
        content, offset, last, total = data[start:start + stored], start + stored, number, total + length
        _require(total <= max_bytes, f"more than {max_bytes} bytes")
        _require(zlib.crc32(content) == checksum, f"checksum of {SECTIONS[number]}")
        raw[number] = _decompressed(content, length, SECTIONS[number])
    _require(offset == len(data), "bytes after the last section")
    _require(set(raw) - ({12, 13} if kind == 1 else set()) == NEEDED[KINDS[kind]], "other sections than this kind has")
    return KINDS[kind], version, {SECTIONS[number]: content for number, content in raw.items()}

def _array(data, dtype):
    _require(len(data) % np.dtype(dtype).itemsize == 0, f"a fraction of {dtype}")
    return np.frombuffer(data, dtype)

def decode(data, max_bytes=4 << 30):
    """The asset that `data` (bytes) holds; its sections may have `max_bytes` in all."""
    kind, version, raw = _sections(data, max_bytes)
    metadata, arrays = _metadata(raw["metadata"]), {}
    if kind == "scene":
        arrays["triangles"] = triangles = _triangles(raw["triangles"])
        arrays["clusters"] = clusters = _array(raw["clusters"], CLUSTER)
        count = int(clusters["vertices"].sum(dtype=np.uint64))
        arrays["vertices"], places, parents, of_vertices = _vertices(raw["vertices"], triangles, count)
        arrays["coefficients"] = _coefficients(raw["coefficients"], clusters, places, parents)
        arrays["basis"] = _basis(raw["basis"], _whole(metadata, "visibility", "basis_resolution"))
        if "second_uvs" in raw:
            arrays["second_uvs"] = _second_uvs(raw["second_uvs"], of_vertices)
        if "transfer" in raw:
            arrays.update(_transfer(raw["transfer"], clusters))
    if kind == "environment":
        arrays.update(lobes=_array(raw["lobes"], LOBE), prefiltered=_prefiltered(_array(raw["prefiltered"], "<u4")))
        arrays.update(sources=_array(raw["sources"], SOURCE), source_texels=_array(raw["source_texels"], "<f4"))
        texels = (arrays["sources"]["rows"].astype(np.uint64) * arrays["sources"]["columns"]).sum()
        _require(3 * texels == len(arrays["source_texels"]), "texels of other sources")
    if "texels" in raw:
        arrays["textures"], texels, flags = [], _array(raw["texels"], np.uint8), int(version > 4)
        _require(isinstance(metadata.get("textures"), list), "metadata: textures")
        for texture in metadata["textures"]:
            width, height = _whole(texture, "width"), _whole(texture, "height")
            size = flags + 4 * width * height
            _require(size <= len(texels) and (texels[0] < 2 or not flags), "texels of a fraction, or another flag")
            own, texels = texels[:size], texels[size:]
            arrays["textures"].append(_texels(own, width, height) if flags else own.reshape(height, width, 4))
        _require(len(texels) == 0, "texels of no texture")
    return Asset(kind, version, metadata, arrays)

def _transfer(data, clusters):
    """Groups, scales, basis numbers, and weights of each group by vertex and component."""
    _require(len(data) >= 24, "transfer ends early")
    order, emitted, _, count = struct.unpack_from("<4I", data)
    _require(order <= 9 and emitted <= 1 and count <= min(len(clusters), (len(data) - 24) // 16), "header of transfer")
    groups = np.frombuffer(data[24:24 + 16 * count], "<u4").reshape(count, 4).astype(np.int64)
    starts = np.append(groups[:, 0], len(clusters))
    _require((np.diff(starts) > 0).all() and (groups[:, 1] <= 24).all(), "groups of transfer")
    edges = np.append(0, np.cumsum(clusters["vertices"], dtype=np.int64))[starts]
    rows = (groups[:, 1] + 1) * groups[:, 2]
    sizes = [4 * int(rows.sum()), int(rows.sum()) * 3 * ((order + 1) ** 2 + emitted),
             int((groups[:, 1] * np.diff(edges)).sum())]
    ends = 24 + 16 * count + np.append(0, np.cumsum(sizes))
    _require(len(data) == int(ends[-1]), "length of transfer")
    scales, basis, held = (data[a:b] for a, b in zip(ends, ends[1:]))
    parts = np.split(np.frombuffer(held, np.uint8), np.cumsum(groups[:, 1] * np.diff(edges))[:-1])
    weights = [np.cumsum(part.reshape(rank, vertices), axis=1, dtype=np.uint64).astype(np.uint8).view(np.int8).T
               for part, rank, vertices in zip(parts, groups[:, 1], np.diff(edges))]
    return {"transfer_groups": groups, "transfer_scales": np.frombuffer(scales, "<f4"),
            "transfer_basis": np.frombuffer(basis, np.int8), "transfer_weights": weights}

def _prefiltered(packed):
    """Levels of N x N RGB, sharpest first."""
    levels, count = [], (3 * len(packed) + 4).bit_length() // 2 - 1
    _require(3 * len(packed) + 4 == 4 ** (count + 1), "prefiltered: a fraction of a level")
    for n in (2 ** level for level in range(count, 0, -1)):
        texels, packed = packed[:n * n].reshape(n, n), packed[n * n:]
        mantissas = np.stack([texels >> shift & 0x1FF for shift in (0, 9, 18)], axis=-1)
        levels.append(np.ldexp(mantissas.astype(np.float32), (texels >> 27).astype(int)[..., None] - 24))
    return levels

def read(path, max_bytes=4 << 30):
    """The asset in a file."""
    with open(path, "rb") as file:
        return decode(file.read(), max_bytes)
