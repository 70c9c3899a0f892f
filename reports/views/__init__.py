"""What is shown of captures, circumstances and studies, a file each; `bench.ground.registry.load_views` finds them by name."""
