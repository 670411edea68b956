"""The work of networks.rs in PyTorch: same sizes, same names, medians in milliseconds. Argument: a filter."""

import sys
import time

import torch
import torch.nn.functional as F
from torch import nn

torch.set_num_threads(2)
FILTER = sys.argv[1] if len(sys.argv) > 1 else ""


def report(name, runs, work):
    if FILTER not in name:
        return
    work()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) * 1e3)
    print(f"PyTorch: {name:<35} {sorted(times)[runs // 2]:9.1f} ms", flush=True)


def mlp(sizes):
    layers = []
    for i, o in zip(sizes, sizes[1:]):
        layers += [nn.Conv2d(i, o, 1, bias=False), nn.BatchNorm2d(o), nn.ReLU()]
    return nn.Sequential(*layers)


LEVELS = [(1024, 0.1), (256, 0.2), (64, 0.4), (16, 0.8)]


def sample(xyz, m):
    chosen = torch.zeros(m, dtype=torch.long)
    nearest = torch.full((xyz.shape[0],), 1e10)
    last = 0
    for i in range(m):
        chosen[i] = last
        nearest = torch.minimum(nearest, ((xyz - xyz[last]) ** 2).sum(-1))
        last = int(nearest.argmax())
    return chosen


def neighbourhoods(points):
    """For one cloud: centres, neighbours, three nearest and their weights at every level."""
    levels, fine = [], points
    for centres, radius in LEVELS:
        coarse = fine[sample(fine, centres)]
        near = torch.cdist(coarse, fine) < radius
        order = torch.where(near, torch.arange(fine.shape[0])[None], fine.shape[0]).topk(
            min(32, fine.shape[0]), largest=False
        )[0]
        if order.shape[1] < 32:
            order = F.pad(order, (0, 32 - order.shape[1]), value=fine.shape[0])
        order = torch.where(order == fine.shape[0], order[:, :1], order)
        distance, nearest = torch.cdist(fine, coarse).topk(3, largest=False)
        weight = 1 / (distance + 1e-8)
        levels.append((fine, coarse, order, nearest, weight / weight.sum(-1, keepdim=True)))
        fine = coarse
    return levels


class PointNet2(nn.Module):
    def __init__(self):
        super().__init__()
        down = [[6, 32, 32, 64], [67, 64, 64, 128], [131, 128, 128, 256], [259, 256, 256, 512]]
        up = [[131, 128, 128, 128], [320, 256, 128], [384, 256, 256], [768, 256, 256]]
        self.down = nn.ModuleList(map(mlp, down))
        self.up = nn.ModuleList(map(mlp, up))
        self.head = mlp([128, 128])

    def forward(self, clouds):
        levels = [torch.stack(parts) for level in zip(*clouds) for parts in zip(*level)]
        levels = [levels[i : i + 5] for i in range(0, len(levels), 5)]
        batch = torch.arange(len(clouds))[:, None, None]
        features = [levels[0][0].transpose(1, 2)]
        for layer, (fine, coarse, order, _, _) in zip(self.down, levels):
            offset = fine[batch, order] - coarse[:, :, None]
            grouped = torch.cat([offset, features[-1].transpose(1, 2)[batch, order]], -1)
            features.append(layer(grouped.permute(0, 3, 1, 2)).amax(-1))
        y = features.pop()
        for layer, (_, _, _, nearest, weight) in reversed(list(zip(self.up, levels))):
            interpolated = (y.transpose(1, 2)[batch, nearest] * weight[..., None]).sum(2).transpose(1, 2)
            y = layer(torch.cat([interpolated, features.pop()], 1)[..., None])[..., 0]
        return self.head(y[..., None])[..., 0]


def block(i, o, stride=1):
    return nn.Sequential(nn.Conv2d(i, o, 3, stride, 1, bias=False), nn.BatchNorm2d(o))


class Basic(nn.Module):
    def __init__(self, i, o, stride):
        super().__init__()
        self.a, self.b = block(i, o, stride), block(o, o)
        around = nn.Sequential(nn.Conv2d(i, o, 1, stride, bias=False), nn.BatchNorm2d(o))
        self.around = nn.Identity() if i == o and stride == 1 else around

    def forward(self, x):
        return F.relu(self.b(F.relu(self.a(x))) + self.around(x))


class Up(nn.Module):
    def __init__(self, i, skip, o):
        super().__init__()
        self.a, self.b = block(i + skip, o), block(o, o)

    def forward(self, x, skip):
        x = torch.cat([F.interpolate(x, scale_factor=2, mode="nearest"), skip], 1)
        return F.relu(self.b(F.relu(self.a(x))))


class UNet(nn.Module):
    def __init__(self, width):
        super().__init__()
        c = [round(64 * width * m) for m in (1, 2, 4, 8)]
        self.stem = nn.Sequential(nn.Conv2d(3, c[0], 7, 2, 3, bias=False), nn.BatchNorm2d(c[0]), nn.ReLU())
        sizes = zip([c[0], *c], c, (1, 2, 2, 2))
        self.down = nn.ModuleList(nn.Sequential(Basic(i, o, s), Basic(o, o, 1)) for i, o, s in sizes)
        ups = [(c[3], c[2], c[2]), (c[2], c[1], c[1]), (c[1], c[0], c[0]), (c[0], c[0], c[0]), (c[0], 3, c[0])]
        self.up = nn.ModuleList(Up(*s) for s in ups)
        self.head = nn.Conv2d(c[0], 128, 1)

    def forward(self, x):
        skips = [x, self.stem(x)]
        y = F.max_pool2d(skips[-1], 3, 2, 1)
        for layer in self.down:
            y = layer(y)
            skips.append(y)
        skips.pop()
        for layer in self.up:
            y = layer(y, skips.pop())
        return self.head(y)


def scan(n):
    half = torch.tensor([0.4, 0.3, 0.5])
    points = (torch.rand(n, 3) * 2 - 1) * half
    for axis in range(3):
        points[axis::3, axis] = half[axis]
    return points


torch.manual_seed(1)
points = scan(10_000)
cloud = PointNet2().eval()
with torch.no_grad():
    many = scan(30_000)
    torch.set_num_threads(1)
    report("sampling 30,000 -> 10,000, one core", 3, lambda: sample(many, 10_000))
    torch.set_num_threads(2)
    report("cloud of 10,000: neighbourhoods", 3, lambda: neighbourhoods(points))
    report("cloud of 10,000: all", 3, lambda: cloud([neighbourhoods(points)]))
    known = neighbourhoods(points)
    report("cloud of 10,000: all but neighbourhoods", 5, lambda: cloud([known]))
    unet = UNet(1.0).eval().to(memory_format=torch.channels_last)
    image = torch.randn(1, 3, 224, 224).to(memory_format=torch.channels_last)
    report("picture 224 x 224: all", 5, lambda: unet(image))


def trainer(net, forward):
    optimiser = torch.optim.Adam(net.parameters(), lr=1e-3)

    def step():
        optimiser.zero_grad()
        forward(net).square().mean().backward()
        optimiser.step()

    return step


if FILTER in "training step, 8 clouds of 10,000":
    clouds = [neighbourhoods(scan(10_000)) for _ in range(8)]
    step = trainer(cloud.train(), lambda net: net(clouds).transpose(1, 2)[:, ::156])
    report("training step, 8 clouds of 10,000", 3, step)
half_width = UNet(0.5).train()
images = torch.randn(8, 3, 128, 128)
step = trainer(half_width, lambda net: net(images)[:, :, ::16, ::16])
report("training step, half width, 8 x 128 x 128", 3, step)
