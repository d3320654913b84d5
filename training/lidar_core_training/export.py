"""A trained network as an ONNX file with a card that says what it is and where it comes from."""

import csv
import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from lidar_core.circles.estimators.architecture import ANSWERS, CONTEXT, SLOT_NUMBERS, SLOTS
from lidar_core.errors import FormatError, NumericalError
from lidar_core.io.files.atomic import written_whole
from lidar_core_training import checkpoint
from lidar_core_training.config import TrainConfig
from lidar_core_training.networks import PaperNet, WindowNet
from lidar_core_training.train import METRICS, NOTE, ORIGIN, TEST
from lidar_core_training.weights import TURNED

OPSET = 17
IR_VERSION = 8
PARITY = 1e-5
"""Largest difference between torch and onnxruntime, relative where answers are above 1."""
_EXAMPLES = 64


class Graph:
    """An ONNX graph that grows node by node; weights keep the names that they have in torch."""

    def __init__(self, network: nn.Module) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []
        tensors = (*network.named_parameters(), *network.named_buffers())
        self.names = {id(tensor): name for name, tensor in tensors}

    def constant(self, value: Any, kind: type[Any] = np.float32) -> str:
        """Add numbers, and return their name."""
        name = f"constant_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(value, dtype=kind), name))
        return name

    def weight(self, tensor: torch.Tensor, *, turned: bool = False) -> str:
        """Add weights of the network, or their transpose."""
        name = self.names[id(tensor)] + (TURNED if turned else "")
        value = tensor.detach().numpy()
        self.weights.append(numpy_helper.from_array(value.T if turned else value, name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add a node, and return the name of what it gives."""
        name = f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [name], name=name, **attributes))
        return name

    def linear(self, layer: nn.Linear, value: str) -> str:
        """Add a linear layer on the last axis."""
        product = self.add("MatMul", value, self.weight(layer.weight, turned=True))
        if layer.bias is None:
            return product
        return self.add("Add", product, self.weight(layer.bias))

    def silu(self, value: str) -> str:
        """Add x * sigmoid(x)."""
        return self.add("Mul", value, self.add("Sigmoid", value))

    def part(self, value: str, axis: int, start: int, end: int) -> str:
        """Add a slice along one axis."""
        bounds = [self.constant([number], np.int64) for number in (start, end, axis)]
        return self.add("Slice", value, *bounds)

    def sum(self, value: str, axis: int) -> str:
        """Add a sum over one axis, which goes away."""
        return self.add("ReduceSum", value, self.constant([axis], np.int64), keepdims=0)

    def wider(self, value: str, axis: int) -> str:
        """Add an axis of length 1."""
        return self.add("Unsqueeze", value, self.constant([axis], np.int64))


def export(run: Path, target: Path, *, name: str | None = None) -> dict[str, Any]:
    """Write the best weights of the run in folder `run` as `target`, with its card beside it.

    Raises
    ------
    FormatError
        There is no finished run in the folder.
    NumericalError
        onnxruntime does not answer as torch does.
    """
    config, results = _finished(run)
    if config.network == "one-step":
        raise FormatError(f"{run}: expected a network that the package runs, got the experiment")
    beams = config.datasets[0].scanner.n_beams
    network = WindowNet() if config.network == "cnn" else PaperNet(beams)
    network.load_state_dict(checkpoint.read_torch(run / checkpoint.BEST))
    network.eval()
    model = _model(network, _metadata(config, results))
    with written_whole(target) as temporary:
        temporary.write_bytes(model.SerializeToString())
    difference = parity(network, target)
    if difference > PARITY:
        raise NumericalError(f"{target}: differs by {difference:g} from torch, not {PARITY:g}")
    card = _card(config, results, run, target, network, difference, name or target.stem)
    with written_whole(target.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    return card


def parity(network: nn.Module, model: Path) -> float:
    """Largest difference between torch and onnxruntime on random inputs."""
    random = np.random.default_rng(0)
    if isinstance(network, WindowNet):
        slots = random.uniform(-1, 1, (_EXAMPLES, SLOTS, SLOT_NUMBERS)).astype(np.float32)
        slots[:, :, 3] = random.uniform(size=(_EXAMPLES, SLOTS)) < 0.7
        slots[:, 0, 3] = 1.0
        spread = random.normal(size=(_EXAMPLES, CONTEXT)).astype(np.float32)
        scale, mean = network.context_std.numpy(), network.context_mean.numpy()
        inputs = {"slots": slots, "context": mean + spread * scale}
    else:
        beams = onnx.load(model).graph.input[0].type.tensor_type.shape.dim[2].dim_value
        scans = np.full((_EXAMPLES, 1, beams), -1.0, np.float32)
        scans[:, 0, 400:460] = random.uniform(size=(_EXAMPLES, 60))
        inputs = {"scans": scans}
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    (answer,) = session.run(None, inputs)
    with torch.no_grad():
        expected = network(*(torch.from_numpy(array) for array in inputs.values())).numpy()
    return float((np.abs(answer - expected) / np.maximum(np.abs(expected), 1.0)).max())


def _finished(run: Path) -> tuple[TrainConfig, dict[str, Any]]:
    if not (run / TEST).exists():
        raise FormatError(f"{run}: expected a finished run, got none: {TEST} is missing")
    return TrainConfig.read(run / NOTE), json.loads((run / TEST).read_text(encoding="utf-8"))


def _metadata(config: TrainConfig, results: dict[str, Any]) -> dict[str, str]:
    """What the runtime has to know, inside the model itself."""
    if config.network == "cnn":
        return {"kind": "windows"}
    scanner = config.datasets[0].scanner
    errors = results["test"][0]["errors"]["all"]
    variances = {f"variance_{name}": errors[f"mse_{name}"] for name in ("x", "y", "radius")}
    known = {**results["normalisation"], **variances, **scanner.model_dump(mode="json")}
    return {"kind": "scans"} | {key: repr(value) for key, value in known.items()}


def _model(network: nn.Module, metadata: dict[str, str]) -> onnx.ModelProto:
    graph = Graph(network)
    if isinstance(network, WindowNet):
        answer, size = _windows(network, graph), ANSWERS
        shapes: dict[str, list[Any]] = {
            "slots": ["batch", SLOTS, SLOT_NUMBERS],
            "context": ["batch", CONTEXT],
        }
    else:
        answer, size = _scans(network, graph), 3
        shapes = {"scans": ["batch", 1, int(metadata["n_beams"])]}
    graph.nodes.append(helper.make_node("Identity", [answer], ["answer"]))
    inputs = [
        helper.make_tensor_value_info(*pair)
        for pair in ((name, TensorProto.FLOAT, shape) for name, shape in shapes.items())
    ]
    output = helper.make_tensor_value_info("answer", TensorProto.FLOAT, ["batch", size])
    made = helper.make_graph(graph.nodes, "circle", inputs, [output], graph.weights)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    helper.set_model_props(model, metadata)
    onnx.checker.check_model(model, full_check=True)
    return model


def _scans(network: nn.Module, graph: Graph) -> str:
    value = "scans"
    for layer in network.features:
        if isinstance(layer, nn.Conv1d):
            weights = graph.weight(layer.weight), graph.weight(layer.bias)
            value = graph.add("Conv", value, *weights, strides=list(layer.stride))
        else:
            value = graph.add("Relu", value)
    value = graph.linear(network.head[0], graph.add("Flatten", value, axis=1))
    return graph.linear(network.head[2], graph.add("Relu", value))


def _windows(network: WindowNet, graph: Graph) -> str:
    """Follow `WindowNet.forward`, line by line."""
    difference, aside, depth, used = (graph.part("slots", 2, k, k + 1) for k in range(4))
    mean, std = graph.weight(network.context_mean), graph.weight(network.context_std)
    scaled = graph.add("Div", graph.add("Sub", "context", mean), std)
    certainty = graph.add("Exp", graph.add("Neg", graph.part("context", 1, 12, 13)))
    whitened = graph.add("Asinh", graph.add("Mul", difference, graph.wider(certainty, 1)))
    larger = graph.add("Mul", difference, graph.constant(4.0))
    products = [graph.add("Mul", aside, aside), graph.add("Mul", whitened, aside)]
    features = graph.add("Concat", larger, whitened, aside, depth, *products, axis=2)
    of_context = graph.wider(graph.linear(network.ray_context, scaled), 1)
    hidden = graph.add("Add", graph.linear(network.ray, features), of_context)
    hidden = graph.linear(network.ray_mix, graph.silu(hidden))
    width = network.ray_mix.out_features
    first, second = (
        graph.part(hidden, 2, *ends) for ends in ((0, network.half), (network.half, width))
    )
    count = graph.sum(used, 1)
    linear = graph.add("Div", graph.sum(graph.add("Mul", first, difference), 1), count)
    general = graph.sum(graph.add("Mul", graph.silu(second), used), 1)
    sure = graph.add("Asinh", graph.add("Mul", linear, certainty))
    general = graph.add("Div", general, count)
    trunk = graph.add("Concat", linear, sure, general, scaled, axis=1)
    trunk = graph.silu(graph.linear(network.enter, trunk))
    for layer in (network.first, network.second):
        trunk = graph.add("Add", trunk, graph.silu(graph.linear(layer, trunk)))
    return graph.linear(network.leave, trunk)


def _card(
    config: TrainConfig,
    results: dict[str, Any],
    run: Path,
    model: Path,
    network: nn.Module,
    difference: float,
    name: str,
) -> dict[str, Any]:
    with (run / METRICS).open(newline="", encoding="utf-8") as file:
        metrics = [
            {key: float(value) for key, value in row.items()} for row in csv.DictReader(file)
        ]
    best = min(metrics, key=lambda row: row.get("validation_loss", row["train_loss"]))
    origin = json.loads((run / ORIGIN).read_text(encoding="utf-8"))
    passes = len(metrics) / config.parts + origin.get("start", {}).get("passes", 0.0)
    return {
        "name": name,
        "sha256": sha256(model.read_bytes()).hexdigest(),
        "bytes": model.stat().st_size,
        "parameters": sum(weight.numel() for weight in network.parameters()),
        "opset": OPSET,
        **origin,
        "passes": passes,
        "best_epoch": best["epoch"],
        "metrics": metrics,
        "largest_difference_from_torch": difference,
        "training": config.model_dump(mode="json"),
        **results,
    }
