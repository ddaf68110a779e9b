"""The end-to-end policy: one network from object rows to the next whole-body keyframe, and a fixed controller."""
