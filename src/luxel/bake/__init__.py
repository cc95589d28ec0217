"""Light written down: bakes as files that other programs show, relit and designed without a new bake."""
