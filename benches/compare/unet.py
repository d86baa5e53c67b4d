"""A plain U-Net of 3x3 convolutions with GEDepth's heads, random weights, as ONNX: in f32 and quantized (QDQ)."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

HEADS = {"residual": 1, "attention": 1, "slope": 11}


class Network:
    def __init__(self, size):
        self.width, self.height = size
        self.nodes, self.weights, self.multiply_adds = [], [], 0
        self.random = np.random.default_rng(0)

    def convolution(self, x, inputs, outputs, stride, step=1, relu=True, name=None):
        """`stride` is the output's, in input pixels of the network; `step` the convolution's own."""
        name = name or f"c{len(self.nodes)}"
        filters = self.random.normal(0, (2 / (9 * inputs)) ** 0.5, (outputs, inputs, 3, 3)).astype(np.float32)
        self.weights += [numpy_helper.from_array(filters, f"{name}.weight"),
                         numpy_helper.from_array(np.zeros(outputs, np.float32), f"{name}.bias")]
        raw = f"{name}.raw" if relu else name
        self.nodes.append(helper.make_node("Conv", [x, f"{name}.weight", f"{name}.bias"], [raw],
                                           kernel_shape=[3, 3], strides=[step, step], pads=[1, 1, 1, 1]))
        if relu:
            self.nodes.append(helper.make_node("Relu", [raw], [name]))
        self.multiply_adds += 9 * inputs * outputs * (self.width // stride) * (self.height // stride)
        return name

    def up(self, x, skip):
        double = f"u{len(self.nodes)}"
        self.nodes.append(helper.make_node("Resize", [x, "", "double"], [double], mode="nearest",
                                           coordinate_transformation_mode="asymmetric", nearest_mode="floor"))
        joined = f"{double}.joined"
        self.nodes.append(helper.make_node("Concat", [double, skip], [joined], axis=1))
        return joined


def build(size, metadata):
    """The model in f32, fixed to `size` (width, height), and its multiply-adds."""
    n = Network(size)
    skips, x, channels, stride = [], "input", 4, 1
    for outputs, more in [(16, 1), (32, 1), (64, 2), (128, 2)]:
        stride *= 2
        x = n.convolution(x, channels, outputs, stride, step=2)
        for _ in range(more):
            x = n.convolution(x, outputs, outputs, stride)
        skips.append((x, outputs))
        channels = outputs
    for skip, outputs in reversed(skips[:-1]):
        stride //= 2
        x = n.convolution(n.up(x, skip), channels + outputs, outputs, stride)
        x = n.convolution(x, outputs, outputs, stride)
        channels = outputs
    for name, outputs in HEADS.items():
        n.convolution(x, channels, outputs, stride, relu=False, name=name)
    n.weights.append(numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "double"))
    shape = [1, 4, n.height, n.width]
    head = [n.height // stride, n.width // stride]
    graph = helper.make_graph(
        n.nodes, "u-net", [helper.make_tensor_value_info("input", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, c, *head]) for name, c in HEADS.items()], n.weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    return model, n.multiply_adds


class Noise(CalibrationDataReader):
    def __init__(self, shape):
        random = np.random.default_rng(1)
        self.pictures = iter([{"input": random.normal(0, 1, shape).astype(np.float32)} for _ in range(2)])

    def get_next(self):
        return next(self.pictures, None)


def unquantize_outputs(graph):
    """Heads leave as f32 rather than through a last QuantizeLinear and DequantizeLinear."""
    makers = {node.output[0]: node for node in graph.node}
    for name in HEADS:
        dequantize = makers[name]
        quantize = makers[dequantize.input[0]]
        makers[quantize.input[0]].output[0] = name
        graph.node.remove(dequantize)
        graph.node.remove(quantize)


def write(folder, size, metadata):
    """Writes `unet-f32.onnx` and `unet-int8.onnx`; returns the multiply-adds."""
    model, multiply_adds = build(size, metadata)
    plain, quantized = folder / "unet-f32.onnx", folder / "unet-int8.onnx"
    onnx.save(model, plain)
    quantize_static(plain, quantized, Noise([1, 4, size[1], size[0]]), quant_format=QuantFormat.QDQ, per_channel=True,
                    activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8)
    model = onnx.load(quantized)
    unquantize_outputs(model.graph)
    helper.set_model_props(model, metadata)
    onnx.save(model, quantized)
    return multiply_adds
