"""A stranger to the bench: plain rclpy with its default quality of service, and what docs/ros.md says.

It uses no module of this project but the messages. It exercises every name of the page and prints, as JSON, what it got.

    python tests/stranger.py docs/ros.md EXPERIMENT.yaml FOLDER
"""

import importlib
import json
import re
import sys
import time
from pathlib import Path

import rclpy
from action_msgs.msg import GoalStatus
from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

NAMESPACE = "/bench"
ENDINGS = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_ABORTED: "aborted",
    GoalStatus.STATUS_CANCELED: "cancelled",
}
# Parameters of rclpy and of the base of all nodes, which the page explains in words.
EVERYWHERE = {"clock", "use_sim_time", "start_type_description_service"}
TYPES = {
    "double": ParameterType.PARAMETER_DOUBLE,
    "integer": ParameterType.PARAMETER_INTEGER,
    "bool": ParameterType.PARAMETER_BOOL,
    "string": ParameterType.PARAMETER_STRING,
    "double array": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "string array": ParameterType.PARAMETER_STRING_ARRAY,
}


def rows(text):
    """Yield the rows of a Markdown table as dictionaries."""
    lines = [line.removeprefix("| ").removesuffix(" |") for line in text.splitlines() if line.startswith("|")]
    titles, _, *body = ([cell.strip() for cell in re.split(r" (?<!\\)\| ?", line)] for line in lines)
    for row in body:
        yield {title: cell.strip("`") for title, cell in zip(titles, row, strict=True)}


def section(page, name):
    return re.search(rf"<!-- {name} -->\n(.*?)\n<!-- /{name} -->", page, re.DOTALL)[1]


def load(name):
    package, kind, type_name = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), type_name)


class Stranger:
    def __init__(self, page):
        self.page = page
        self.node = rclpy.create_node("stranger")
        self.messages = {}
        self.report = {"topics": {}, "services": {}, "actions": {}, "parameters": {}, "wrong": []}

    def until(self, done, what, timeout=60.0):
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                sys.exit(f"stranger: waited in vain for {what}")
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def subscribe(self):
        for row in rows(section(self.page, "topics")):
            name = row["topic"] if row["topic"].startswith("/") else f"{NAMESPACE}/{row['topic']}"
            self.messages[row["topic"]] = []
            self.node.create_subscription(load(row["type"]), name, self.messages[row["topic"]].append, 10)

    def call(self, name, service_type, **fields):
        client = self.node.create_client(service_type, name)
        self.until(client.service_is_ready, f"the service {name}")
        future = client.call_async(service_type.Request(**fields))
        self.until(future.done, f"a response from {name}")
        self.node.destroy_client(client)
        return future.result()

    def read_parameters(self):
        text = section(self.page, "parameters")
        for part in re.split(r"^### ", text, flags=re.MULTILINE)[1:]:
            name, table = part.split("\n", 1)
            documented = {row["parameter"]: row for row in rows(table)}
            node = self.find(name)
            listed = set(self.call(f"{node}/list_parameters", ListParameters).result.names)
            for difference in listed ^ (set(documented) | EVERYWHERE):
                self.report["wrong"].append(f"{name}: {difference} is on the page or in the node, but not both")
            names = sorted(documented)
            descriptors = self.call(f"{node}/describe_parameters", DescribeParameters, names=names).descriptors
            values = self.call(f"{node}/get_parameters", GetParameters, names=names).values
            for key, descriptor, value in zip(names, descriptors, values, strict=True):
                row = documented[key]
                found = {
                    "meaning": descriptor.description,
                    "range": descriptor.additional_constraints,
                    "read-only": "yes" if descriptor.read_only else "no",
                }
                for title, what in found.items():
                    if row[title].replace("\\|", "|").strip("` ") != what.strip("` "):
                        self.report["wrong"].append(f"{name}: {key}: {title} is {what!r}, on the page {row[title]!r}")
                bounded = descriptor.floating_point_range or descriptor.integer_range
                if bool(row["range"]) != bool(bounded):
                    self.report["wrong"].append(f"{name}: {key}: the range of the descriptor is {bounded}")
                if value.type != TYPES[row["type"]]:
                    self.report["wrong"].append(f"{name}: {key}: has type {value.type}, on the page {row['type']}")
                self.report["parameters"][f"{name}.{key}"] = True
            # What can be set takes its own value; what is read-only does not.
            parameters = [Parameter(name=key, value=value) for key, value in zip(names, values, strict=True)]
            answers = self.call(f"{node}/set_parameters", SetParameters, parameters=parameters).results
            for key, answer in zip(names, answers, strict=True):
                if answer.successful != (documented[key]["read-only"] == "no"):
                    self.report["wrong"].append(f"{name}: {key}: setting it gives {answer.successful}: {answer.reason}")

    def find(self, name):
        """Return the full name of a node."""

        def found():
            return [f"{space}/{node}" for node, space in self.node.get_node_names_and_namespaces() if node == name]

        self.until(found, f"the node {name}")
        return found()[0]

    def send(self, name, action_type, cancel=False, **fields):
        """Send a goal, and cancel it on its first feedback if that is asked for; return how it ended, and why."""
        client = ActionClient(self.node, action_type, f"{NAMESPACE}/{name}")
        self.until(client.server_is_ready, f"the action {name}")
        refusals = self.messages["refusals"]
        begin = len(refusals)
        feedback = []
        sent = client.send_goal_async(action_type.Goal(**fields), feedback.append)
        self.until(sent.done, f"an answer to a goal of {name}")
        if sent.result().accepted:
            ended = sent.result().get_result_async()
            if cancel:
                self.until(lambda: feedback, f"feedback of {name}")
                cancelled = sent.result().cancel_goal_async()
                self.until(cancelled.done, f"an answer to the cancelling of {name}")
            self.until(ended.done, f"the result of {name}", 120.0)
            status = ENDINGS[ended.result().status]
            answer = [status, ended.result().result.message, len(feedback)]
        else:
            # Whoever is rejected learns the reason from the topic.
            self.until(lambda: refusals[begin:], f"the reason why {name} was rejected")
            answer = ["rejected", refusals[-1].data, 0]
        client.destroy()
        return answer

    def send_goals(self, experiment, folder):
        hybrid = Path(__file__).resolve().parents[1] / "config/control/hybrid_test.yaml"
        goals = {
            "run_control": {
                "experiment": hybrid.read_text().replace("duration_s: 10", "duration_s: 5"),
                "bag": f"{folder}/hybrid",
            },
            "run_experiment": {"experiment": experiment, "bag": f"{folder}/one"},
            "run_set": {"experiments": [Path(experiment).read_text()], "folder": f"{folder}/set"},
            "identify": {
                "runs": [f"{folder}/one"],
                "model": "bingham",
                "population": 8,
                "generations": 2,
                "seeds": 1,
                "no_profile": True,
                "output": folder,
            },
            "diagnose": {
                "runs": [f"{folder}/one"],
                "model": "bingham",
                "effects": ["seal_friction", "force_sensor_lag"],
                "output": folder,
            },
            # A whole one takes a minute; this one is refused before anything moves.
            "diagnose_on_bench": {"model": "bingham", "budget": 1.0, "folder": f"{folder}/on_bench"},
        }
        for row in rows(section(self.page, "actions")):
            name, action_type = row["action"], load(row["type"])
            self.report["actions"][name] = {
                "good": self.send(name, action_type, **goals[name]),
                "empty": self.send(name, action_type),
            }
        types = {row["action"]: load(row["type"]) for row in rows(section(self.page, "actions"))}
        for name, changes in (
            ("run_experiment", {"bag": f"{folder}/cancelled"}),
            ("run_set", {"folder": f"{folder}/cancelled set"}),
            ("identify", {"generations": 100_000}),
            ("diagnose", {"effects": []}),
            ("diagnose_on_bench", {"budget": 0.0}),
        ):
            self.report["actions"][name]["cancelled"] = self.send(name, types[name], True, **goals[name] | changes)

    def call_services(self, experiment, folder):
        requests = {
            "load_experiment": {"experiment": Path(experiment).read_text()},
            "start_recording": {"bag": f"{folder}/by_hand", "experiment": Path(experiment).read_text()},
        }
        for row in rows(section(self.page, "services")):
            fields = requests.get(row["service"], {})
            response = self.call(f"{NAMESPACE}/{row['service']}", load(row["type"]), **fields)
            self.report["services"][row["service"]] = [response.success, response.message]

    def publish(self):
        """Move nothing by a setpoint of one's own, and stop the bench, by publishers of the default quality of service."""
        types = {row["topic"]: load(row["type"]) for row in rows(section(self.page, "topics"))}
        publishers = {
            name: self.node.create_publisher(types[name], f"{NAMESPACE}/{name}", 10)
            for name in ("setpoint", "emergency_stop")
        }
        for name, publisher in publishers.items():
            self.until(publisher.get_subscription_count, f"somebody who hears {name}")

        reset = self.call(f"{NAMESPACE}/reset_fault", Trigger)
        if not reset.success:
            sys.exit(f"stranger: reset_fault: {reset.message}")
        health, modes = self.messages["/diagnostics"], self.messages["bench_state"]
        begin = len(health)

        def is_refused():
            publishers["setpoint"].publish(types["setpoint"](position=0.01, coil_current=0.5))
            told = [status.message for message in health[begin:] for status in message.status]
            return any(line.startswith("a setpoint is refused: the bench is in mode idle; ") for line in told)

        self.until(is_refused, "the refusal of a setpoint")
        publishers["emergency_stop"].publish(types["emergency_stop"](data=True))
        self.until(lambda: modes[-1].mode == modes[-1].FAULT, "the emergency stop")

    def main(self, experiment, folder):
        self.subscribe()
        self.read_parameters()
        self.send_goals(experiment, folder)
        self.call_services(experiment, folder)
        self.publish()
        self.report["topics"] = {name: len(messages) for name, messages in self.messages.items()}
        joints = self.messages["joint_states"]
        self.report["efforts"] = [len(joint.effort) for joint in joints]
        self.report["not a number"] = sum(value != value for joint in joints for value in [*joint.position, *joint.effort])
        print(json.dumps(self.report))


if __name__ == "__main__":
    rclpy.init()
    Stranger(Path(sys.argv[1]).read_text()).main(*sys.argv[2:])
