"""The interactive viewer: what a camera shows of a splat, raw and enhanced, and the page that it is seen on."""
