"""Whether threads share a heap, by what glibc tells of its own."""

import subprocess
import sys
from pathlib import Path

import pytest

HEAPS = """
import ctypes, sys, threading
from service.cli.heap import share_heap

if sys.argv[1] == "shared":
    share_heap()
barrier = threading.Barrier(4)

def work():
    barrier.wait()
    kept = [bytes(5000) for _ in range(100)]
    barrier.wait()
    del kept

threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(sys.argv[2].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_threads_share_a_heap(tmp_path: Path) -> None:
    heaps = {}
    for how in ("shared", "own"):
        subprocess.run([sys.executable, "-c", HEAPS, how, str(tmp_path / how)], check=True)
        heaps[how] = (tmp_path / how).read_text().count("<heap nr=")
    assert heaps["shared"] == 1 < heaps["own"]
