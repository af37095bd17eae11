"""Nobody but this machine's browser at the printed address speaks to the workbench."""

import base64
import http.client
import os
import signal
import socket
import subprocess

import pytest
from workbench_helpers import Served, served

pytestmark = [pytest.mark.web, pytest.mark.slow]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served") / "study"
    (folder.parent / "secret.txt").write_text("not yours")
    with served(folder) as one:
        (folder / "mine.txt").write_text("mine")
        yield one


def asked(made: Served, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
    link = http.client.HTTPConnection("127.0.0.1", made.port, timeout=60)
    given = {key.replace("_", "-"): value for key, value in headers.items()}
    link.putrequest("GET", path, skip_host="Host" in given)
    for key, value in given.items():
        link.putheader(key, value)
    link.endheaders()
    answer = link.getresponse()
    found = answer.status, {key.lower(): value for key, value in answer.getheaders()}, answer.read().decode()
    link.close()
    return found


def with_cookie(made: Served) -> str:
    _, headers, _ = asked(made, f"/?token={made.token}")
    return headers["set-cookie"].partition(";")[0]


def test_one_line_is_printed_and_the_address_opens(made):
    assert made.address.startswith("http://127.0.0.1:")
    status, headers, text = asked(made, f"/?token={made.token}")
    assert status == 200
    assert "SameSite=Strict" in headers["set-cookie"]
    assert "HttpOnly" in headers["set-cookie"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert made.token not in text


@pytest.mark.parametrize(
    "path", ["/", "/records", "/frames/1", "/own/uq.js", "/study/mine.txt", "/_nicegui/x", "/stop"]
)
def test_every_route_wants_the_token(made, path):
    for query in ("", "?token=", "?token=wrong", f"?token={made.token[:-1]}", f"?token={made.token}&token=x"):
        status, _, text = asked(made, path + query)
        assert status == 403, (path, query)
        assert "ultraquiet serve" in text


def test_the_cookie_is_as_good_as_the_token_and_another_is_not(made):
    assert asked(made, "/study/mine.txt", Cookie=with_cookie(made))[2] == "mine"
    assert asked(made, "/study/mine.txt", Cookie=f"ultraquiet-{made.port}=wrong")[0] == 403
    assert asked(made, "/study/mine.txt", Cookie="=;;\x7f")[0] in (400, 403)


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1:1"},
        {"Host": "127.0.0.1.evil.example"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
    ids=str,
)
def test_other_hosts_and_origins_are_refused_even_with_the_token(made, headers):
    assert asked(made, f"/?token={made.token}", **headers)[0] == 403
    assert asked(made, "/study/mine.txt", Cookie=with_cookie(made), **headers)[0] == 403


@pytest.mark.parametrize(
    "path",
    ["../secret.txt", "%2e%2e/secret.txt", "..%2fsecret.txt", "/etc/passwd", "%2fetc%2fpasswd", "a/../../secret.txt"],
)
def test_paths_outside_the_study_are_refused(made, path):
    status, _, text = asked(made, f"/study/{path}", Cookie=with_cookie(made))
    assert status in (403, 404)
    assert "not yours" not in text
    assert "root:" not in text


def upgraded(made: Served, **headers: str) -> bytes:
    """The first line that answers the opening of a websocket."""
    key = base64.b64encode(os.urandom(16)).decode()
    lines = ["GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1", "Upgrade: websocket"]
    lines += ["Connection: Upgrade", f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13"]
    given = {"Host": f"127.0.0.1:{made.port}", **headers}
    lines += [f"{name}: {value}" for name, value in given.items()]
    with socket.create_connection(("127.0.0.1", made.port), timeout=30) as link:
        link.sendall("\r\n".join([*lines, "", ""]).encode())
        return link.recv(200).split(b"\r\n")[0]


def test_a_websocket_wants_the_cookie_and_the_right_origin(made):
    cookie, own = with_cookie(made), f"http://127.0.0.1:{made.port}"
    assert b"101" in upgraded(made, Cookie=cookie, Origin=own)
    assert b"403" in upgraded(made, Origin=own)
    assert b"403" in upgraded(made, Cookie=cookie, Origin="http://evil.example")
    assert b"403" in upgraded(made, Cookie=cookie, Host="evil.example")


def test_it_listens_on_127_0_0_1_alone(made):
    with open("/proc/net/tcp") as table:
        rows = [line.split()[1] for line in table.readlines()[1:] if line.split()[3] == "0A"]
    ours = [row for row in rows if int(row.split(":")[1], 16) == made.port]
    assert ours == [f"0100007F:{made.port:04X}"]
    with open("/proc/net/tcp6") as table:
        assert not [line for line in table if f":{made.port:04X} " in line.split("  ")[0] and " 0A " in line]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_it_cleanly(tmp_path, number):
    made = Served(tmp_path / "study")
    assert made.address
    made.process.send_signal(number)
    code, out, err = made.stop()
    assert code == 0
    assert out == "", "one line is printed, and no other"
    assert "Traceback" not in err
    left = subprocess.run(["pgrep", "-f", str(tmp_path)], capture_output=True, text=True, check=False).stdout.split()
    assert not left, "no process stays behind"


def test_a_port_that_is_taken_is_said(tmp_path, made):
    one = Served.__new__(Served)
    with pytest.raises(ValueError, match="invalid literal"):
        one.__init__(tmp_path / "study", "--port", str(made.port))
    code, _, err = one.stop()
    assert code == 2
    assert f"port {made.port} cannot be used" in err
