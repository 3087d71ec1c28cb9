"""What runs on the bus, shown live: a WebSocket server that Foxglove opens, with the layout that goes with it."""
