"""How far a noisy result may be from the truth before a single run proves that its uncertainty is too small.

Over sockets the noise differs from run to run, because readings are taken at other moments. A bound of 1.5 U (three
deviations) fails a few of a hundred healthy runs where it is asked of several axes at once. Whether U holds 95 % is
shown by campaigns over many seeds (``make soak``).
"""

FAR_OUTSIDE = 2.5  # times U (k = 2): five deviations, one in a million
