"""The frame and its drivers: from a scene and a method to a picture, a sequence, a truth."""
