"""Pictures for engineers: one function a figure, each drawing into a figure or into a part of a page."""
