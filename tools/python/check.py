"""Prints CRC-32s of what is read, for tests to compare: check.py FILE..."""
import json
import sys
import zlib

import numpy as np
import relight_reader

for path in sys.argv[1:]:
    asset = relight_reader.read(path)
    lists = {name: value if isinstance(value, list) else [value] for name, value in asset.arrays.items()}
    checksums = {name: [zlib.crc32(np.ascontiguousarray(array).tobytes()) for array in arrays]
                 for name, arrays in lists.items()}
    print(json.dumps({"kind": asset.kind, "metadata": asset.metadata, "arrays": checksums}))
