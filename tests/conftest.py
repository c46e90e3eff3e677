"""For all tests: what they start is interrupted by Ctrl+C, also where a script put the tests behind `&`."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # inherited; children would ignore it as well
    signal.signal(signal.SIGINT, signal.default_int_handler)
