"""Peak memory of one method in a process of its own: python -m lib.peak METHOD DATASET_FOLDER

Prints one line of JSON: megabytes before the method's packages are loaded, and at most.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from lib.contenders import CONTENDERS, RawPair
from lib.resident import peak_mb, resident_mb
from svc_ros.io.datasets import read_dataset


def main() -> None:
    """One pair, once."""
    name, folder = sys.argv[1:]
    dataset = read_dataset(Path(folder))
    raw = RawPair.read(dataset, dataset.pairs[0])
    before = resident_mb()
    CONTENDERS[name](raw)()
    print(json.dumps({"before_mb": before, "peak_mb": peak_mb()}))


if __name__ == "__main__":
    main()
