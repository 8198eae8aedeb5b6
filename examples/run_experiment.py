"""Homes the rod of a running bench and runs an experiment, with rclpy alone: for benches without the full `ros2` command.

python examples/run_experiment.py config/experiments/characterise/07_fast_sine.yaml runs/by_hand
"""

import argparse
import sys
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from mrd_interfaces.action import RunExperiment


def main() -> None:
    """Parse the arguments, home, run the experiment and print how it ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("experiment", metavar="EXPERIMENT.yaml")
    parser.add_argument("bag", metavar="BAG", help="folder to record into; must not exist")
    parser.add_argument("--namespace", default="/bench", help="of the nodes (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the experiment's random waveforms (default %(default)s)")
    parser.add_argument("--timeout", type=float, default=60.0, metavar="SECONDS", help="to wait for the nodes")
    arguments = parser.parse_args()

    rclpy.init()
    node = Node("run_experiment", namespace=arguments.namespace)
    home = node.create_client(Trigger, "home")
    run_experiment = ActionClient(node, RunExperiment, "run_experiment")
    if not (home.wait_for_service(arguments.timeout) and run_experiment.wait_for_server(arguments.timeout)):
        sys.exit(f"error: no supervisor in {arguments.namespace}; start the nodes first (docs/ros.md)")

    homed = answer(node, home.call_async(Trigger.Request()))
    if not homed.success:
        sys.exit(f"error: home: {homed.message}")
    goal = RunExperiment.Goal(experiment=arguments.experiment, bag=arguments.bag, seed=arguments.seed)
    handle = answer(node, run_experiment.send_goal_async(goal))
    if not handle.accepted:
        sys.exit("error: the supervisor refused the experiment; its log says why")
    ended = answer(node, handle.get_result_async()).result
    run_experiment.destroy()
    node.destroy_node()
    rclpy.shutdown()
    if not ended.success:
        sys.exit(f"error: {ended.message}")
    print(f"{ended.bag}: {ended.samples} samples, {ended.lost} lost; {ended.message}")


def answer(node: Node, future: Future) -> Any:
    """Return the result of a call once it is there."""
    rclpy.spin_until_future_complete(node, future)
    return future.result()


if __name__ == "__main__":
    main()
