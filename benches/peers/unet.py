"""The U-Net in PyTorch, under the parameter names of our weights folders."""

import json
import struct
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional as F


class Block(nn.Module):
    def __init__(self, inputs, outputs, stride):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            conv = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(conv, nn.BatchNorm2d(outputs))

    def forward(self, x):
        around = x if self.downsample is None else self.downsample(x)
        y = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(y)) + around)


class Up(nn.Module):
    def __init__(self, inputs, skip, outputs):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs + skip, outputs, 3, 1, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)

    def forward(self, x, skip):
        x = torch.cat([F.interpolate(x, scale_factor=2, mode="nearest"), skip], 1)
        x = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(x)))


class Encoder(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.conv1 = nn.Conv2d(3, c[0], 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(c[0])
        self.layer1 = nn.Sequential(Block(c[0], c[0], 1), Block(c[0], c[0], 1))
        self.layer2 = nn.Sequential(Block(c[0], c[1], 2), Block(c[1], c[1], 1))
        self.layer3 = nn.Sequential(Block(c[1], c[2], 2), Block(c[2], c[2], 1))
        self.layer4 = nn.Sequential(Block(c[2], c[3], 2), Block(c[3], c[3], 1))

    def forward(self, x):
        x0 = F.relu(self.bn1(self.conv1(x)))
        x1 = self.layer1(F.max_pool2d(x0, 3, 2, 1))
        x2 = self.layer2(x1)
        x3 = self.layer3(x2)
        return x0, x1, x2, x3, self.layer4(x3)


class Decoder(nn.Module):
    def __init__(self, c):
        super().__init__()
        sizes = [(c[3], c[2], c[2]), (c[2], c[1], c[1]), (c[1], c[0], c[0]), (c[0], c[0], c[0]), (c[0], 3, c[0])]
        self.blocks = nn.ModuleList(Up(*size) for size in sizes)

    def forward(self, y, skips):
        for block, skip in zip(self.blocks, skips):
            y = block(y, skip)
        return y


class UNet(nn.Module):
    def __init__(self, width, features):
        super().__init__()
        c = [round(64 * width * m) for m in (1, 2, 4, 8)]
        self.encoder = Encoder(c)
        self.decoder = Decoder(c)
        self.head = nn.Conv2d(c[0], features, 1)

    def decode(self, x):
        x0, x1, x2, x3, x4 = self.encoder(x)
        return self.decoder(x4, (x3, x2, x1, x0, x))

    def forward(self, x):
        return self.head(self.decode(x))

    def features_at(self, x, view, row, column):
        """The head at some pixels only, as in training."""
        return F.linear(self.decode(x)[view, :, row, column], self.head.weight[:, :, 0, 0], self.head.bias)


def read_safetensors(path):
    """Tensors of a safetensors file, as f32."""
    data = Path(path).read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    kinds = {"F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
    tensors = {}
    for name, entry in header.items():
        if name != "__metadata__":
            start, end = (8 + size + at for at in entry["data_offsets"])
            raw = torch.frombuffer(bytearray(data[start:end]), dtype=kinds[entry["dtype"]])
            tensors[name] = raw.reshape(entry["shape"]).float()
    return tensors


def load(folder):
    """The U-Net of a weights folder, for prediction, and the side of its pictures."""
    config = json.loads((Path(folder) / "config.json").read_text())
    net = UNet(config["width"], config["features"])
    tensors = read_safetensors(Path(folder) / "model.safetensors")
    ours = {name.removeprefix("backbone."): t for name, t in tensors.items() if name.startswith("backbone.")}
    missing, unexpected = net.load_state_dict(ours, strict=False)
    missing = [name for name in missing if not name.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise SystemExit(f"weights do not fit: missing {missing}, unexpected {unexpected}")
    return net.eval(), config["preprocessing"]["image_side"]
