"""Laws against tones: resonators, adaptive laws, Youla-Kucera."""
