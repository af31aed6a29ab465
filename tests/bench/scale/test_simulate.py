#!/usr/bin/env python3
"""simulate.py against what can be computed by hand."""

import unittest

from simulate import Costs, Plan, simulate

FREE = dict(start_s=0, look_s=0, claim_s=0, write_s=0, bandwidth=1e18, task_starts_per_s=1e9, node_mtbf_h=1e12, spread=0)


class Model(unittest.TestCase):
    def test_one_core_needs_the_time_of_all_examples(self):
        r = simulate(Plan(1000, 10, 1, 1), Costs(**FREE | dict(example_s=0.5)))
        self.assertAlmostEqual(r["seconds"], 500.0, places=6)
        self.assertEqual((r["files"], r["tasks"], r["failures"]), (100, 1, 0))

    def test_cores_share_the_examples(self):
        r = simulate(Plan(1600, 10, 16, 1), Costs(**FREE | dict(example_s=0.5)))
        self.assertAlmostEqual(r["seconds"], 50.0, places=6)
        self.assertAlmostEqual(r["efficiency"], 1.0, places=6)
        # 16 tasks on two processors take eight times as long.
        r = simulate(Plan(1600, 10, 16, 1, processors=2), Costs(**FREE | dict(example_s=0.5)))
        self.assertAlmostEqual(r["seconds"], 400.0, places=6)

    def test_a_slow_disk_is_the_limit(self):
        r = simulate(Plan(10000, 10, 100, 1), Costs(**FREE | dict(example_s=0.01, example_bytes=1e6, bandwidth=1e8)))
        self.assertAlmostEqual(r["seconds"], 10000 * 1e6 / 1e8, delta=1.0)
        self.assertGreater(r["server_load"], 0.99)

    def test_each_task_looks_at_each_file_once(self):
        # 8 tasks and 100 files: at most 800 looks, and so many claims as files.
        r = simulate(Plan(1000, 10, 8, 1), Costs(**FREE | dict(example_s=1e-6, look_s=1e-3, claim_s=1e-2)))
        self.assertLessEqual(r["seconds"] * r["server_load"], 800 * 1e-3 + 100 * 1e-2 + 1e-9)
        self.assertGreaterEqual(r["seconds"] * r["server_load"], 100 * 1e-2)

    def test_failing_nodes_lose_examples_and_time(self):
        costs = FREE | dict(example_s=1.0)
        good = simulate(Plan(100000, 100, 64, 1), Costs(**costs))
        bad = simulate(Plan(100000, 100, 64, 1), Costs(**costs | dict(node_mtbf_h=0.1)))
        self.assertEqual(good["lost_examples"], 0)
        self.assertGreater(bad["failures"], 0)
        self.assertGreater(bad["lost_examples"], 0)
        self.assertGreater(bad["seconds"], good["seconds"])


if __name__ == "__main__":
    unittest.main()
