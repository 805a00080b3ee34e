"""CPU time of tests: that of the processes and threads which they start counts, that of others does not."""

import subprocess
import sys
import threading

import cpu_times

COMPUTES_S = 0.3
CHILD = f"import time\nwhile time.process_time() < {COMPUTES_S}: pass\nprint('done', flush=True)\ninput()\n"


def test_what_a_child_computes_counts_while_it_lives_and_once_it_has_ended():
    begun = cpu_times._tree_s()
    with subprocess.Popen([sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"done\n"
        assert cpu_times._tree_s() - begun > 0.9 * COMPUTES_S
        child.communicate(b"\n")
    assert cpu_times._tree_s() - begun > 0.9 * COMPUTES_S


def test_a_child_of_another_thread_counts_too():
    begun, found = cpu_times._tree_s(), []

    def start():
        with subprocess.Popen([sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
            child.stdout.readline()
            found.append(cpu_times._tree_s() - begun)
            child.communicate(b"\n")

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    assert found[0] > 0.9 * COMPUTES_S


def test_a_process_that_has_ended_took_nothing_more():
    with subprocess.Popen([sys.executable, "-c", ""]) as child:
        pass
    assert cpu_times._tree_s(child.pid) == 0.0
