"""How every role's Zenoh session reaches the others, on one host and across several."""

from __future__ import annotations

from typing import Any

PATIENCE_S = 0.02  # longest a publisher waits for a stuck subscriber; Zenoh's 1 ms loses samples on an idle host
# Every message waits in a buffer of this size until its inbox is read. Zenoh's 64 KiB are 2 GiB for a monitor that is
# held up for 4 s at 8 kHz, and filling them with zeros costs more than the message; the largest of ours has 300 bytes.
BATCH_BYTES = 2048
# What Zenoh's threads may share, in its own notation: one thread watches all sockets, reads and writes. A second one is
# woken for every message and finds nothing to do, and a link that was opened by Zenoh's `net` thread is watched there.
# Round trip at 4 kHz 190 -> 145 us with reading and writing where the socket is watched, a tenth less with one thread
# for all; estimator at 8 kHz 99 -> 80 % of a core.
THREADS = "(rx: (handover: acc), tx: (handover: acc), net: (handover: acc), acc: (worker_threads: 1))"
RETRY_MS = (50, 250)  # first and longest pause between two attempts to reach a role that is not there


def peer_settings(listen: str, connect: list[str], link: dict[str, Any] | None = None) -> dict[str, Any]:
    """Zenoh's settings of a role that listens at `listen` and looks for others at `connect`, and nowhere else.

    link: what there is to say of its links beside.
    """
    return {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "listen": {"endpoints": [listen], "exit_on_failure": True},
        "connect": {
            "endpoints": connect,
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": RETRY_MS[0], "period_max_ms": RETRY_MS[1], "period_increase_factor": 2},
        },
        "open": {"return_conditions": {"connect_scouted": False, "declares": True}},
        "transport": {
            "shared_memory": {"enabled": False},  # gains nothing at a hundred bytes
            "link": (link or {})
            | {
                "tx": {
                    "batch_size": BATCH_BYTES,
                    "queue": {
                        "size": {"real_time": 16},  # batches
                        "congestion_control": {"drop": {"wait_before_drop": int(PATIENCE_S * 1e6)}},
                    },
                }
            },
        },
    }
