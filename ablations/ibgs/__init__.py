"""IBGS, a published peer: a residual from neighbouring photos over a splat, trained for each scene.

After Nguyen, Mao, Alvarez and Liu, "IBGS: Image-Based Gaussian Splatting", NeurIPS 2025 (arXiv 2511.14357), from the
paper's description. What differs: the splat is a finished fit and stays as it is, where the paper trains both together;
each pixel has one intersection with the surface, the fit's median depth, where the paper blends several.
"""
