"""Views to report on: small pictures with known differences, and names that try to break the page."""

import torch

from gaussian_enhancer.report.compared import ComparedView

NASTY = "</script><script>alert('1')</script> & \"quoted\" $name \u2028 \ud800.png"
REASON = "not measured: no backbone; run gaussian-enhancer measure <lpips>"


def compared(
    name: str,
    gain: float,
    seed: int,
    *,
    photo: bool = True,
    height: int = 48,
    width: int = 64,
    milliseconds: float = 12.5,
) -> ComparedView:
    noise = torch.Generator().manual_seed(seed)
    truth = torch.rand(3, height, width, generator=noise)
    raw = (truth + 0.2 * torch.randn(3, height, width, generator=noise)).clamp(0, 1)
    enhanced = truth + 0.5 * (raw - truth)
    raws = {"psnr": 20.123456789 + seed, "psnr_aligned": 21.0, "ssim": 0.7}
    enhanceds = {"psnr": 20.623456789 + seed, "psnr_aligned": 21.0 + gain, "ssim": 0.75 - seed / 100}
    if not photo:
        return ComparedView(name, lambda: raw, lambda: enhanced, milliseconds=milliseconds)
    reads = (lambda: raw), (lambda: enhanced), (lambda: truth)
    return ComparedView(name, *reads, raws, enhanceds, milliseconds, {"lpips_alex": REASON})
