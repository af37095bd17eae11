"""Draw the README's picture from a finished study: python docs/examples/readme_picture.py DIR > docs/payload.svg."""

import json
import sys
from pathlib import Path

import numpy as np

from ultraquiet.plot import draw_svg, figure_of
from ultraquiet.plot.pages.payload import Before, payload_chart

folder = Path(sys.argv[1])
summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
law = summary["requirements"]["law"]
facts = json.loads((folder / "stages" / f"payload-{law}.json").read_text(encoding="utf-8"))["facts"]
units = {
    name: Before(
        np.array(felt["f_hz"]),
        (np.array(felt["open_transmissibility"]), np.array(felt["closed_transmissibility"])),
        (np.array(felt["open_cumulative"]), np.array(felt["closed_cumulative"])),
    )
    for name, felt in facts["curves"].items()
}
first = next(iter(facts["units"].values()))
words = ("payload over base", "", first["unit"])
print(draw_svg(figure_of(payload_chart("payload", law, units, words, tuple(first["band_hz"]), ""))))
