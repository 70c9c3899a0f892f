"""touchbench: which recogniser of touch gestures should I ship?"""
