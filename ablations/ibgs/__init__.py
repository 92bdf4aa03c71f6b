"""IBGS, a published peer: a residual from neighbouring photos over a splat, trained for each scene.

Written from the description in Nguyen, Mao, Alvarez and Liu, "IBGS: Image-Based Gaussian Splatting", NeurIPS 2025
(arXiv 2511.14357). Two differences: the splat is a finished fit that is not changed, whereas the paper trains both
together; each pixel has one intersection with the surface, the fit's median depth, whereas the paper blends several.
"""
