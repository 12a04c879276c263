"""Runs a command as a child of this small process; prints its wall time (s) and peak memory (ru_maxrss) as JSON.

The kernel counts the memory of the process that started a child as the child's own peak, so a large benchmark cannot
measure a small child directly.
"""

import json
import os
import subprocess
import sys
import time

began = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
seconds = time.perf_counter() - began
child.returncode = os.waitstatus_to_exitcode(status)
print(json.dumps({"exit": child.returncode, "seconds": seconds, "maxrss": usage.ru_maxrss}))
