"""The interactive viewer: a page in the browser that shows a splat from any camera, raw and enhanced."""
