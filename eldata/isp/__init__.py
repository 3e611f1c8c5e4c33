"""Raw to sRGB."""
