"""Reads `.relight` assets into numpy arrays, as FORMAT.md describes them.

    asset = relight_reader.read("statue.relight")
    asset.kind                      # "scene", "environment" or "material"
    asset.metadata["materials"]     # dicts, lists, numbers, strings; variants are names, or (name, fields)
    asset.arrays["vertices"]["position"]

Bytes are untrusted: whatever is wrong raises `Invalid`, before memory is asked for that the
file does not justify. Values are as stored: radians, metres, linear Rec.709.
"""

import struct
import zlib
from dataclasses import dataclass

import numpy as np
import zstandard

MAGIC = b"RELIGHT\n"
VERSIONS = (4,)
KINDS = {1: "scene", 2: "environment", 3: "material"}
SECTIONS = dict(enumerate("metadata vertices triangles clusters coefficients basis texels lobes prefiltered"
                          " sources source_texels transfer".split(), 1))
NEEDED = {"scene": {1, 2, 3, 4, 5, 6, 7}, "environment": {1, 8, 9, 10, 11}, "material": {1, 7}}
OPTIONAL = {"scene": {12}, "environment": set(), "material": set()}

VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("tangent", "<f4", 4), ("uv", "<f4", 2)])
TRIANGLE = np.dtype([("vertices", "<u4", 3), ("material", "<u2"), ("cluster", "<u2")])
CLUSTER = np.dtype([("first_vertex", "<u4"), ("vertices", "<u4"), ("first_coefficient", "<u4"),
                    ("first_tile", "<u4"), ("tiles", "<u4"), ("scale", "<f4")])
SOURCE = np.dtype([("theta", "<f4"), ("phi", "<f4"), ("row_step", "<f4"), ("column_step", "<f4"),
                   ("rows", "<u4"), ("columns", "<u4")])
LOBE = np.dtype([("axis", "<f4", 3), ("sharpness", "<f4"), ("amplitude", "<f4", 3), ("reserved", "<u4")])

class Invalid(ValueError):
    """The bytes are not a valid asset."""

def _require(holds, message):
    if not holds:
        raise Invalid(message)

@dataclass
class Asset:
    """An asset: `kind`, `version`, `metadata` (a dict) and `arrays` (by section)."""

    kind: str
    version: int
    metadata: dict
    arrays: dict

# The fields of metadata, in order: struct codes, "string", names of this table, or (how, ...).
SLOT = ("optional", "slot")
TYPES = {
    "slot": [("texture", "I"), ("transform", "6f")],
    "lobe": [("f0", "3f"), ("f90", "3f"), ("roughness", "f")],
    "specular": ("variant", ("None",), ("BlinnPhong", ("specular", "3f"), ("exponent", "f")),
                 ("Ward", ("specular", "3f"), ("alpha", "2f")), ("CookTorrance", ("f0", "3f"), ("roughness", "f")),
                 ("Ggx", ("f0", "3f"), ("alpha", "2f")), ("AshikhminShirley", ("f0", "3f"), ("exponents", "2f")),
                 ("Lobes", ("path", "string"), ("lobes", ("list", "lobe")), ("ratio", SLOT))),
    "layer": [("diffuse", "3f"), ("specular", "specular"), ("weight", "f"), ("blend", ("variant", ("Over",), ("Coat",))),
              ("diffuse_texture", SLOT), ("specular_texture", SLOT), ("roughness_texture", SLOT), ("weight_texture", SLOT)],
    "surface": ("variant", ("MetallicRoughness", ("base_color", "3f"), ("metallic", "f"), ("roughness", "f"),
                            ("anisotropy_strength", "f"), ("anisotropy_rotation", "f")),
                ("Layered", ("diffuse", "3f"), ("specular", "specular")), ("Layers", ("layers", ("list", "layer")))),
    "plain material": [("name", "string"), ("surface", "surface"), ("base_color_texture", SLOT),
                       ("metallic_roughness_texture", SLOT), ("normal_texture", SLOT), ("normal_scale", "f"),
                       ("anisotropy_texture", SLOT), ("emission", "3f"), ("emission_texture", SLOT)],
    "texture": [("width", "I"), ("height", "I"), ("encoding", ("variant", ("Srgb",), ("Linear",), ("Rgbe",)))],
    "camera": [("position", "3f"), ("target", "3f"), ("up", "3f"),
               ("field_of_view", ("variant", ("X", ("radians", "f")), ("Y", ("radians", "f"))))],
    "visibility": [("representation", ("variant", ("ClusteredPca",), ("GlobalPca",))), ("sample_resolution", "I"),
                   ("basis_resolution", "I"), ("distance_clamp", "f"), ("ray_offset", "f")],
    "report": [("source_vertices", "Q"), ("source_triangles", "Q"), ("errors", "4f"), ("warnings", ("list", "string"))],
    "scene": [("name", "string"), ("visibility", "visibility"), ("camera", ("optional", "camera")),
              ("materials", ("list", "plain material")), ("textures", ("list", "texture")), ("report", "report")],
    "environment": [("source", "string"), ("source_size", "2I"), ("repaired_pixels", "Q"), ("relative_l2", "f"),
                    ("energy_error", "3f")],
    "material": [("source", "string"), ("relative_l2", "f"), ("corrected_relative_l2", "f"), ("shaded_relative_l2", "f"), ("albedo_error", "f"),
                 ("material", "plain material"), ("textures", ("list", "texture"))],
}

class _Metadata:
    def __init__(self, data):
        self.data, self.at = data, 0

    def bytes(self, size):
        _require(size <= len(self.data) - self.at, "metadata ends early")
        self.at += size
        return self.data[self.at - size:self.at]

    def read(self, kind):
        """A value of a type of TYPES."""
        kind = TYPES.get(kind, kind) if isinstance(kind, str) else kind
        if isinstance(kind, list):
            return {name: self.read(field) for name, field in kind}
        if kind == "string":
            try:
                return self.bytes(self.read("Q")).decode()
            except UnicodeDecodeError as error:
                raise Invalid("metadata: a string that is not UTF-8") from error
        if isinstance(kind, str):
            value = struct.unpack("<" + kind, self.bytes(struct.calcsize("<" + kind)))
            _require(all(np.isfinite(v) for v in value), "metadata: a number that is not finite")
            return value[0] if len(value) == 1 else list(value)
        if kind[0] == "list":
            count = self.read("Q")
            _require(count <= len(self.data) - self.at, "metadata: a list beyond the end")
            return [self.read(kind[1]) for _ in range(count)]
        if kind[0] == "optional":
            flag = self.read("B")
            _require(flag <= 1, "metadata: an optional field that is neither 0 nor 1")
            return self.read(kind[1]) if flag else None
        index = self.read("I")
        _require(index < len(kind) - 1, f"metadata: variant {index} of {len(kind) - 1}")
        name, *fields = kind[index + 1]
        return (name, self.read(fields)) if fields else name

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
    corners = np.empty((held.shape[1], 3), np.int64)
    following = 0
    for index, differences in enumerate(held[:3].T.tolist()):
        for corner, difference in enumerate(differences):
            vertex = (following - difference) & 0xFFFFFFFF
            corners[index, corner] = vertex
            following = max(following, vertex + 1)
    triangles = np.zeros(len(corners), TRIANGLE)
    triangles["vertices"] = corners
    triangles["material"] = np.cumsum(held[3] & 0xFFFF, dtype=np.uint64) & 0xFFFF
    triangles["cluster"] = np.cumsum(held[3] >> 16, dtype=np.uint64) & 0xFFFF
    return triangles

def _expected(triangles, count):
    """Three places (or vertices) for each: it is expected to be the first two's sum less the third."""
    parents = np.repeat(np.arange(-1, count - 1, dtype=np.int64)[:, None], 3, axis=1)
    parents[0] = 0
    known = np.zeros(count, bool)
    latest = {}
    for corners in triangles.tolist():
        for place, vertex in enumerate(corners):
            a, b = corners[(place + 1) % 3], corners[(place + 2) % 3]
            if not known[vertex] and vertex > a and vertex > b:
                known[vertex] = True
                others = (latest.get(end, ()) for end in (a, b))
                across = (next((c for c in other if c not in (a, b)), vertex) for other in others
                          if a in other and b in other)
                parents[vertex] = a, b, next((c for c in across if c < vertex), a)
        for vertex in corners:
            latest[vertex] = corners
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
        rounded = (_ordered(exact.astype("<f4")).view("<i4").astype(np.int64) if exponent == -128
                   else np.rint(np.ldexp(exact, -exponent)).astype(np.int64))
        integers = (rounded + differences) % (1 << 32)
    words = integers.astype("<u4")
    if exponent == -128:
        return _ordered(words).view("<f4")
    return np.ldexp(words.view("<i4").astype(np.float64), exponent).astype("<f4")

def _vertices(data, triangles, count):
    """Vertices, the place of each, and what places are expected from."""
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
    numbers = np.zeros((count, 12), "<f4")
    for column in range(3):
        numbers[:, column] = _column(at_places[column], exponents[column], of_places, None)[places]
    with np.errstate(all="ignore"):
        for column in range(9):
            exact = None
            if column == 0 and mode & 1:
                first = np.full(count, -1)
                first[corners[::-1].ravel()] = np.repeat(np.arange(len(corners))[::-1], 3)
                a, b, c = np.moveaxis(numbers[:, :3].astype(np.float64)[corners], 1, 0)
                u, v = b - a, c - a
                n = u[:, [1, 2, 0]] * v[:, [2, 0, 1]] - u[:, [2, 0, 1]] * v[:, [1, 2, 0]]
                square = n[:, 0] * n[:, 0] + n[:, 1] * n[:, 1] + n[:, 2] * n[:, 2]
                normals = np.append(n / np.sqrt(square)[:, None], np.zeros((1, 3)), axis=0)[first]
            if column == 3 and mode & 2:
                x, z = numbers[:, 3].astype(np.float64), numbers[:, 5].astype(np.float64)
                l = np.sqrt(x * x + z * z)
                around = np.where(l[:, None] > 0, np.stack([z / l, 0 * l, -x / l], axis=1), [1.0, 0.0, 0.0])
            if column < 3 and mode & 1:
                exact = normals[:, column]
            if 3 <= column < 6 and mode & 2:
                exact = around[:, column - 3]
            numbers[:, 3 + column] = _column(others[column], exponents[3 + column], of_vertices, exact)
    return numbers.view(VERTEX).ravel(), places, of_places

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
    for y in range(n):
        for x in range(n):
            l = image[:, y, x - 1] if x else image[:, y - 1, 0]  # the first texel's is 0 still
            a = image[:, y - 1, x] if y else l
            c = l if not y else image[:, y - 1, x - 1] if x else a
            r = image[:, y - 1, x + 1] if y and x + 1 < n else a
            ll = image[:, y, x - 2] if x > 1 else l
            aa = image[:, y - 2, x] if y > 1 else a
            predicted = np.clip((12 * l + 6 * a + 6 * r - c - 2 * ll - 5 * aa + 8) >> 4, -127, 127)
            image[:, y, x] = (left[:, y, x] + predicted + 128) % 256 - 128
    _require(not (image == -128).any(), "a basis texel of -128")
    return np.ascontiguousarray(image.astype(np.int8).reshape(-1, 4, n, n).transpose(0, 2, 3, 1))

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
    _require(len(data) >= 24 and data[:8] == MAGIC, "no .relight file")
    version, kind, count, reserved = struct.unpack_from("<4I", data, 8)
    _require(version in VERSIONS, f"version {version}, this reads {VERSIONS}")
    _require(kind in KINDS and count <= 64 and reserved == 0, "header")
    offset, last, total, raw = 24 + 32 * count, 0, 0, {}
    _require(len(data) >= offset, "the section table ends early")
    for index in range(count):
        number, checksum, start, stored, length = struct.unpack_from("<2I3Q", data, 24 + 32 * index)
        _require(number in SECTIONS and number > last, f"section {number} out of order")
        _require(start == offset and start + stored <= len(data), f"section {SECTIONS[number]} elsewhere")
        content, offset, last, total = data[start:start + stored], start + stored, number, total + length
        _require(total <= max_bytes, f"more than {max_bytes} bytes")
        _require(zlib.crc32(content) == checksum, f"checksum of {SECTIONS[number]}")
        raw[number] = _decompressed(content, length, SECTIONS[number])
    kind = KINDS[kind]
    _require(offset == len(data) and set(raw) - OPTIONAL[kind] == NEEDED[kind], "missing sections or trailing bytes")
    return kind, version, {SECTIONS[number]: content for number, content in raw.items()}

def _array(data, dtype):
    _require(len(data) % np.dtype(dtype).itemsize == 0, f"a fraction of {dtype}")
    return np.frombuffer(data, dtype)

def decode(data, max_bytes=4 << 30):
    """The asset that `data` (bytes) holds; its sections may have `max_bytes` in all."""
    kind, version, raw = _sections(data, max_bytes)
    fields = _Metadata(raw["metadata"])
    metadata = fields.read(kind)
    _require(fields.at == len(fields.data), "metadata goes on after its end")
    arrays = {}
    if kind == "scene":
        arrays["triangles"] = triangles = _triangles(raw["triangles"])
        arrays["clusters"] = clusters = _array(raw["clusters"], CLUSTER)
        count = int(clusters["vertices"].sum(dtype=np.uint64))
        arrays["vertices"], places, parents = _vertices(raw["vertices"], triangles, count)
        arrays["coefficients"] = _coefficients(raw["coefficients"], clusters, places, parents)
        arrays["basis"] = _basis(raw["basis"], metadata["visibility"]["basis_resolution"])
        if "transfer" in raw:
            arrays.update(_transfer(raw["transfer"], clusters))
    if kind == "environment":
        arrays.update(lobes=_array(raw["lobes"], LOBE), prefiltered=_prefiltered(_array(raw["prefiltered"], "<u4")))
        arrays.update(sources=_array(raw["sources"], SOURCE), source_texels=_array(raw["source_texels"], "<f4"))
        texels = 3 * (arrays["sources"]["rows"].astype(np.uint64) * arrays["sources"]["columns"]).sum()
        _require(texels == len(arrays["source_texels"]), "texels of other sources")
    if "texels" in raw:
        arrays["textures"], texels = [], _array(raw["texels"], np.uint8)
        for texture in metadata["textures"]:
            size = texture["height"] * texture["width"] * 4
            _require(size <= len(texels), "texels of a fraction of the textures")
            arrays["textures"].append(texels[:size].reshape(texture["height"], texture["width"], 4))
            texels = texels[size:]
        _require(len(texels) == 0, "texels of no texture")
    return Asset(kind, version, metadata, arrays)

def _transfer(data, clusters):
    """Groups, scales, basis numbers, and weights of each group by vertex and component."""
    _require(len(data) >= 24, "transfer ends early")
    order, emitted, bounces, count = struct.unpack_from("<4I", data)
    _require(order <= 9 and emitted <= 1 and count <= len(clusters), "header of transfer")
    _require(24 + 16 * count <= len(data), "transfer ends early")
    groups = np.frombuffer(data[24:24 + 16 * count], "<u4").reshape(count, 4).astype(np.int64)
    starts = np.append(groups[:, 0], len(clusters))
    _require((np.diff(starts) > 0).all() and (groups[:, 1] <= 12).all(), "groups of transfer")
    edges = np.append(0, np.cumsum(clusters["vertices"], dtype=np.int64))[starts]
    rows = (groups[:, 1] + 1) * groups[:, 2]
    sizes = [4 * int(rows.sum()), int(rows.sum()) * 3 * ((order + 1) ** 2 + emitted),
             int((groups[:, 1] * np.diff(edges)).sum())]
    ends = 24 + 16 * count + np.append(0, np.cumsum(sizes))
    _require(len(data) == int(ends[-1]), "length of transfer")
    scales, basis, held = (data[a:b] for a, b in zip(ends, ends[1:]))
    weights, at, held = [], 0, np.frombuffer(held, np.uint8)
    for rank, vertices in zip(groups[:, 1].tolist(), np.diff(edges).tolist()):
        part = held[at:at + rank * vertices].reshape(rank, vertices)
        weights.append(np.cumsum(part, axis=1, dtype=np.uint64).astype(np.uint8).view(np.int8).T)
        at += rank * vertices
    return {"transfer_groups": groups, "transfer_scales": np.frombuffer(scales, "<f4"),
            "transfer_basis": np.frombuffer(basis, np.int8), "transfer_weights": weights}

def _prefiltered(packed):
    """Levels of N x N RGB, sharpest first."""
    levels, count = [], 0
    while len(packed) > sum(4 ** level for level in range(1, count + 1)):
        count += 1
    for n in (2 ** level for level in range(count, 0, -1)):
        _require(len(packed) >= n * n, "prefiltered: a fraction of a level")
        texels, packed = packed[:n * n].reshape(n, n), packed[n * n:]
        mantissas = np.stack([texels >> shift & 0x1FF for shift in (0, 9, 18)], axis=-1)
        levels.append(np.ldexp(mantissas.astype(np.float32), (texels >> 27).astype(int)[..., None] - 24))
    return levels

def read(path, max_bytes=4 << 30):
    """The asset in a file."""
    with open(path, "rb") as file:
        return decode(file.read(), max_bytes)
