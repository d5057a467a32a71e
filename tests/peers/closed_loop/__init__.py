"""The paper's closed loop written a second time, in numpy, for any plant: controller, cover and experiments."""
