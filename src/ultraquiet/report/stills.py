"""The stills of a page, drawn by this process and, where there are many, by a second one beside it."""

import base64
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from threading import Thread

from ultraquiet.plot import Figure, draw_small_png

MOST_BYTES = 60_000  # of a still
MANY = 16  # pictures, below which a second process would take longer to start than it draws
SHARE = 0.4  # of them, what that process draws: it has libraries to load first


def stills(figures: Sequence[Figure]) -> list[str]:
    """Return each figure as a PNG in base64; the same bytes whichever process draws it."""
    if len(figures) < MANY or (os.cpu_count() or 1) < 2:
        return [_still(figure) for figure in figures]
    own = round((1 - SHARE) * len(figures))
    command, pipe, quiet = [sys.executable, "-m", __name__], subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=quiet) as process:
        answer: list[bytes] = []
        given = pickle.dumps(figures[own:])
        reader = Thread(target=lambda: answer.append(process.communicate(given)[0]), daemon=True)
        reader.start()
        try:
            drawn = [_still(figure) for figure in figures[:own]]
            reader.join()
        finally:
            process.kill()
    if process.returncode == 0 and answer:
        return drawn + pickle.loads(answer[0])
    return drawn + [_still(figure) for figure in figures[own:]]


def _still(figure: Figure) -> str:
    return base64.b64encode(draw_small_png(figure, MOST_BYTES)).decode()


if __name__ == "__main__":
    sys.stdout.buffer.write(pickle.dumps([_still(figure) for figure in pickle.load(sys.stdin.buffer)]))
