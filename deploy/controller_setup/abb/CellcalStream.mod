MODULE CellcalStream
  ! cellcal: sends the joints of ROB_1 by UDP, 250 times a second, and moves nothing. Option 689-1 (EGM).
  ! Configuration > Communication > Transmission Protocol: name UCdevice, type UDPUC, remote address = the
  ! computer with cellcal, remote port 6510. Position stream only: this module holds no instruction of EGM that moves.
  VAR egmident idCellcal;

  ! Beside CellcalServer: call it in main of CellcalServer, before the loop.
  PROC StartCellcalStream()
    EGMReset idCellcal;
    EGMGetId idCellcal;
    EGMSetupUC ROB_1, idCellcal, "default", "UCdevice" \Joint;
    EGMStreamStart idCellcal \SampleRate:=4;
  ENDPROC

  ! Without CellcalServer: PP to this routine, start. It sends until it is stopped.
  PROC CellcalStreamAlone()
    StartCellcalStream;
    WHILE TRUE DO
      WaitTime 1;
    ENDWHILE
  ENDPROC
ENDMODULE
