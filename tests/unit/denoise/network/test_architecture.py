import numpy as np
import pytest

from spikingtac.denoise.infer import NetworkDenoiser
from stand_ins.denoiser_training import noisy_maps

torch = pytest.importorskip("torch")

from spikingtac_paper.training.architecture import (  # noqa: E402
    FOLD,
    EvFlowNet,
    LeanUNet,
    apply_network,
    make_network,
)
from spikingtac_paper.training.export import export_network  # noqa: E402


@pytest.mark.parametrize("kind", ["lean", "evflownet"])
def test_the_exported_graph_is_the_network(kind, tmp_path):
    torch.manual_seed(0)
    network = (LeanUNet() if kind == "lean" else EvFlowNet(base=2)).eval()
    maps = torch.from_numpy(np.array(noisy_maps(2)))[:, None, :32]
    plain, int8 = export_network(network, kind, tmp_path, maps)
    given = maps[:1]
    with torch.no_grad():
        logits = apply_network(network, given, FOLD[kind])
    cleaned = NetworkDenoiser(plain).clean(maps[0, 0].numpy())
    assert cleaned.std() > 1e-4
    assert np.abs(cleaned - torch.sigmoid(logits)[0, 0].numpy()).max() < 1e-5
    assert (int8 is None) == (kind == "evflownet")
    if int8 is not None:
        assert np.abs(NetworkDenoiser(int8).clean(maps[0, 0].numpy()) - cleaned).mean() < 0.02


def test_the_published_size_is_twenty_gmac():
    sides = [160, 80, 40, 20, *[20] * 4, 40, 80, 160, 320, 320]
    with torch.device("meta"):
        network = make_network("evflownet")
    layers = [module for module in network.modules() if isinstance(module, torch.nn.Conv2d)]
    weights = [np.prod(layer.weight.shape) for layer in layers]
    counted = np.dot(weights, np.square(sides))
    assert counted / 1e9 == pytest.approx(20.0, rel=0.15)
