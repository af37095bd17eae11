"""A warm process whose children make a stage and are killed at a change of its folder; driven by lines of JSON."""

import json
import os
import sys
import tempfile
from pathlib import Path

from small_study import dying
from test_transactions import stage

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as warm:  # what is imported late would be imported by every child again
        stage(Path(warm), 1.0)
    print("ready", flush=True)
    for line in sys.stdin:
        folder, gain, death = json.loads(line)
        pid = os.fork()
        if pid == 0:
            dying(Path(folder), death)
            stage(Path(folder), gain, lambda _: None)
            os._exit(0)
        print(json.dumps(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0), flush=True)
