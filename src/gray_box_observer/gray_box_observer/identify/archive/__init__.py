"""Archives: many bags, each identified by itself, one after another or spread over a cluster."""
