"""Makes the pictures of a report in docs/images: `.venv/bin/python tools/report_pictures.py`.

Simulates a drive and replays it first, unless an earlier call did so (out/report_pictures).
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
from pathlib import Path

from chromium import Chromium
from PIL import Image

PROJECT_ROOT = Path(__file__).resolve().parent.parent
DRIVE = ("--scans", "70", "--seed", "5", "--moving-share", "0.3")
STRIDE = "9"  # 27 m between the two scans of a pair: some pairs see too little of the same
DESKTOP, PHONE = (1300, 1570), (390, 844)
READY = "window.svcReport && window.svcReport.ready && document.querySelector('#view3d canvas')"


def make_report(folder: Path) -> Path:
    """Simulate and replay with the program itself; returns the report."""
    drive, run = folder / "street", folder / "run"
    program = (sys.executable, "-m", "svc_ros")
    if not (drive / "reference_tum.txt").is_file():
        subprocess.run([*program, "simulate", "--out", str(drive), *DRIVE], check=True)
    if not (run / "report.html").is_file():
        reference = str(drive / "reference_tum.txt")
        subprocess.run(
            [*program, "replay", str(drive / "bag"), "--mode", "pair", "--stride", STRIDE,
             "--reference", reference, "--out", str(run)], check=True,
        )  # fmt: skip
    return run / "report.html"


def photograph(browser: Chromium, report: Path, scheme: str, at: str) -> bytes:
    """What the window shows when the element `at` stands at its top."""
    browser.prefer(scheme)
    browser.open(report)
    browser.wait_for(READY)
    browser.evaluate(f"document.querySelector('{at}').scrollIntoView({{behavior: 'instant'}})")
    browser.evaluate("new Promise((done) => setTimeout(done, 1500))")  # fonts, and the canvas in its last size
    return browser.picture()


def main() -> None:
    """Write docs/images/report.png, report_dark.png and report_phone.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=PROJECT_ROOT / "out/report_pictures", help="drive and replay")
    parser.add_argument("--out", type=Path, default=PROJECT_ROOT / "docs/images")
    options = parser.parse_args()
    report = make_report(options.work)
    with Chromium() as browser:
        for name, scheme, at, size in (
            ("report", "light", "body", DESKTOP),
            ("report_dark", "dark", "#pairs", DESKTOP),
            ("report_phone", "light", "#pairs", PHONE),
        ):
            phone = size is PHONE
            browser.resize(*size, phone=phone, scale=2.0 if phone else 1.0)
            with Image.open(io.BytesIO(photograph(browser, report, scheme, at))) as picture:
                few = picture.convert("RGB").quantize(256, Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE)
                few.save(options.out / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
