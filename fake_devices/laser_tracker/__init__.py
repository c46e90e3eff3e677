"""A laser tracker behind an emScon server."""
