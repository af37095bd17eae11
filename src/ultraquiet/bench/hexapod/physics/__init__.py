"""What the hexapod is made of: its numbers, its geometry, its struts and sensors, and how they move together."""
