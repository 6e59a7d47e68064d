import numpy as np
import pytest

from spikingtac.denoise.infer import NetworkDenoiser
from stand_ins.denoiser_training import noisy_maps

torch = pytest.importorskip("torch")

from spikingtac_paper.training.architecture import (  # noqa: E402
    NetworkConfig,
    apply_network,
    make_network,
)
from spikingtac_paper.training.export import export_network  # noqa: E402

CONFIGS = [
    NetworkConfig(widths=(8, 16)),
    NetworkConfig(fold=4, widths=(8, 8)),
    NetworkConfig(widths=(8, 16), depth=3),
    NetworkConfig(kind="evflownet", fold=1, base=2),
    NetworkConfig(kind="evflownet", fold=2, base=2),
]


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_the_exported_graph_is_the_network(config, tmp_path):
    torch.manual_seed(0)
    network = make_network(config).eval()
    maps = torch.from_numpy(np.array(noisy_maps(2)))[:, None, :32]
    plain, int8 = export_network(network, config, tmp_path, maps)
    given = maps[:1]
    with torch.no_grad():
        logits = apply_network(network, given, config.fold)
    cleaned = NetworkDenoiser(plain).clean(maps[0, 0].numpy())
    assert cleaned.std() > 1e-4
    assert np.abs(cleaned - torch.sigmoid(logits)[0, 0].numpy()).max() < 1e-5
    assert (int8 is None) == (config.kind == "evflownet")
    if int8 is not None:
        assert np.abs(NetworkDenoiser(int8).clean(maps[0, 0].numpy()) - cleaned).mean() < 0.02


def test_the_published_size_is_twenty_gmac():
    sides = [160, 80, 40, 20, *[20] * 4, 40, 80, 160, 320, 320]
    with torch.device("meta"):
        network = make_network(NetworkConfig(kind="evflownet", fold=1, base=64))
    layers = [module for module in network.modules() if isinstance(module, torch.nn.Conv2d)]
    weights = [np.prod(layer.weight.shape) for layer in layers]
    counted = np.dot(weights, np.square(sides))
    assert counted / 1e9 == pytest.approx(20.0, rel=0.15)
