"""Models of unknown objects, fused from depth images of many sides."""
