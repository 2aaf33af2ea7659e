"""Line integral convolution: textures with streaks along a field."""
