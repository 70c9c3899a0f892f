"""Views of captures, circumstances and run kinds; `bench.ground.registry.load_views` finds them."""
