"""Operation of a fleet from one computer, over the control ports of its robots and over SSH."""
