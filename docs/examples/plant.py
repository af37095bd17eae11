"""A plant that speaks the line protocol of docs/line-protocol.md: two sprung masses, the twin of plant.c.

    python plant.py            on standard input and output
    python plant.py 5025       on TCP port 5025 of this machine, one driver after another
    python plant.py 5025 192.168.0.7 token.txt
                               on one address of this machine, for drivers that say the word of token.txt

Standard library only. Put your own plant into `reset`, `step` and HANDSHAKE.
"""

import hmac
import socket
import sys
from pathlib import Path

HANDSHAKE = """\
ultraquiet-plant 1
rate 2000
actuator N -25 25 push 1
actuator N -25 25 push 2
sensor m/s -10 10 speed 1
sensor m/s -10 10 speed 2
ahead 64
ready
"""


class Plant:
    """Two masses on springs, coupled a little."""

    def __init__(self):
        self.reset()

    def reset(self):
        """Return to rest."""
        self.position, self.speed = [0.0, 0.0], [0.0, 0.0]

    def step(self, u, d):
        """Return what is read now; `u` and `d` act until the next sample."""
        h, stiffness, damping, coupling = 1.0 / 2000.0, 9.0e4, 12.0, 0.125
        y = list(self.speed)
        for i in range(2):
            push = u[i] + d[i]
            force = push - stiffness * self.position[i] - damping * self.speed[i] + coupling * y[1 - i]
            self.speed[i] = self.speed[i] + h * force
            self.position[i] = self.position[i] + h * self.speed[i]
        return y


LONGEST_LINE = 1 << 20
WATCHDOG_S = 10.0  # a driver that is silent for so long in the middle of a run has gone, whatever became of it


def serve(plant, connection, token=""):
    """Serve one driver on TCP, and bring the plant to rest however that ends; the next one finds it sound."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        # Two streams: one for both would drop the lines it has read ahead whenever it writes.
        with connection.makefile("r") as lines, connection.makefile("w", newline="\n") as out:
            answer(plant, lines, out, token, connection.settimeout)
    except (OSError, ValueError, IndexError) as error:  # hung up, silent, or not talking this protocol
        print(f"the driver was given up: {error}", file=sys.stderr)


def answer(plant, lines, out, token="", patience=lambda seconds: None):
    """Answer every line until the driver hangs up; one that does not say the token moves nothing."""
    try:
        answer_lines(plant, lines, out, token, patience)
    finally:
        plant.reset()  # the driver has gone: hardware would be brought to rest here


def answer_lines(plant, lines, out, token, patience):
    """Answer every line; `patience` is told how long the next one may take, None for ever."""
    known = not token
    patience(WATCHDOG_S)
    for line in iter(lambda: lines.readline(LONGEST_LINE), ""):
        word, *rest = line.split() or [""]
        if word == "hello":
            known = known or hmac.compare_digest(" ".join(rest[1:]).encode(), token.encode())
        if not known:
            out.write("error the token is missing or another\n")
            out.flush()
            break
        if word == "step":
            numbers = [float(text) for text in rest]
            half = len(numbers) // 2
            out.write(f"y {' '.join(map(repr, plant.step(numbers[:half], numbers[half:])))}\n")
        elif word == "hello":
            patience(None)  # between runs a driver may think for hours
            out.write(HANDSHAKE)
        elif word in ("reset", "end"):
            plant.reset()
            patience(WATCHDOG_S if word == "reset" else None)
            out.write("ok\n")
        else:
            out.write(f"error unknown word {word}\n")
        out.flush()


if __name__ == "__main__":
    if len(sys.argv) == 1:
        answer(Plant(), sys.stdin, sys.stdout)
    else:
        port, address, token_file = [*sys.argv[1:], *("127.0.0.1", "")[len(sys.argv) - 2 :]]
        secret = Path(token_file).read_text().strip() if token_file else ""
        # One named address: whoever reaches an open port may move the actuators.
        with socket.create_server((address, int(port))) as server:
            while True:
                connection, _ = server.accept()
                with connection:
                    serve(Plant(), connection, secret)
