"""A Ray cluster on this machine, of several processes, for tests; it ends with its standard input, or after 10 minutes.

Commands, one a line, each answered by a line: "node" adds a node, "kill" ends it without a word, "head" the first one.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

SIZE = 100 * 2**20  # of the memory for results


def main() -> None:
    signal.alarm(600)
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 2, "include_dashboard": False, "object_store_memory": SIZE}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    nodes: list[Any] = []
    print("up", cluster.address, flush=True)
    for line in sys.stdin:
        if line.strip() == "node":
            nodes.append(cluster.add_node(num_cpus=1, object_store_memory=SIZE))
        elif line.strip() == "kill":
            cluster.remove_node(nodes.pop(), allow_graceful=False)
        elif line.strip() == "head":
            cluster.remove_node(cluster.head_node, allow_graceful=False)
        print("done", os.getpid(), flush=True)
    if cluster.head_node is not None:
        cluster.shutdown()


if __name__ == "__main__":
    main()
