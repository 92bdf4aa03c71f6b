"""What the page about peers on the same fits says of itself."""

TITLE = "Peers on the same fits"

ABOUT = """Held-out views of the same fits, enhanced by our networks, by a peer and by controls: 3DGS with spherical
harmonics of degree 3, at the last step of each fit. PSNR is colour-aligned unless it says plain; a gain in LPIPS alone
does not count. The worst views of means over captures are those of all of them.

`ibgs` is our own implementation of the residual of IBGS (Nguyen et al., NeurIPS 2025), from the paper's description; it
is neither the authors' code nor their weights, and not the whole method. **The splat is a finished fit and stays as it
is**, where the paper trains splat and network together; each pixel has one intersection with the surface, the fit's
median depth, where the paper blends several; photos have the renders' resolution. The network has 64,979 parameters
(the paper's about 66,000). It is trained for each fit, on that fit's training views alone, each with the other training
photos as its sources: 1,500 steps of two crops of 96x96 pixels (`gaussian-enhancer ibgs fit=FIT`). Source views are the
4 nearest under 30 degrees, of which the nearest 3 count at a pixel where relative depth agrees within 0.01. As in the
paper, colours are brought to the exposure of the nearest photo by an affine map; `ibgs without exposure` leaves that
out. The map is left out in training, since these splats were not fitted under it; it changes aligned PSNR only where
colours are cut off. A network of one scene knows that scene; ours has learnt from other scenes.

Controls: `average of render and references` is the mean of the render and of the photos that the network of `lr_tiny`
is given, warped and weighed by their visibility. `average of two fits` is the mean of the renders of two fits of the
scene that differ in their seed. A claim must beat both.

This page is made by `gaussian-enhancer convergence about=same_fits
methods=[lr_tiny,ibgs,'ibgs:without_exposure',average,two_fits] last=true runs=[FITS] ibgs=[TRAININGS] second=[FITS]
records=docs/results/same_fits.jsonl page=docs/results/same_fits.md`."""
