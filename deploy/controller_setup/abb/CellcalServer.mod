MODULE CellcalServer
  ! cellcal: moves the axes to jTarget, one step at a time. Load into T_ROB1, PP to main, start in AUTO.
  ! cellcal writes jTarget, nTime and nHeart first and nReq last.
  PERS num nReq := 0;
  PERS num nAck := 0;
  PERS num nState := 0;  ! 0 off, 1 waiting, 2 moving, 3 stopped
  PERS num nStop := 0;   ! 1: brake and give up the step
  PERS num nHeart := 0;  ! raised by cellcal while it waits for a step
  PERS num nLife := 0;   ! raised here
  PERS num nTime := 1;   ! seconds that the step takes
  PERS jointtarget jTarget := [[0,0,0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  ! the tool that is selected when main begins: its load counts in each motion (tool0 weighs 1 g)
  PERS tooldata tMounted := [TRUE,[[0,0,0],[1,0,0,0]],[0.001,[0,0,0.001],[1,0,0,0],0,0,0]];
  VAR num nStep := 0;  ! the request that is under way
  VAR jointtarget jGoal;
  VAR num nHeartBefore := 0;
  VAR num nSilent := 0;
  VAR intnum iTick;

  PROC main()
    nAck := nReq;
    tMounted := CTool();
    IDelete iTick;
    CONNECT iTick WITH Tick;
    ITimer 0.1, iTick;
    WHILE TRUE DO
      Serve;
    ENDWHILE
  ENDPROC

  PROC Serve()
    IF nStop <> 0 THEN
      nState := 3;
      WaitUntil nStop = 0;
      nAck := nReq;  ! a step that was ordered before the stop is given up
    ENDIF
    nState := 1;
    WaitUntil nReq <> nAck OR nStop <> 0 \PollRate := 0.05;
    IF nStop = 0 THEN
      nStep := nReq;  ! acknowledged at the end: a request that comes while the arm moves is the next step
      jGoal := CJointT();  ! cellcal moves the robot alone: a track or positioner stays where it is
      jGoal.robax := jTarget.robax;
      nSilent := 0;
      nState := 2;
      MoveAbsJ jGoal \NoEOffs, v100 \T := nTime, fine, tMounted \WObj := wobj0;
      nState := 1;
      nAck := nStep;
    ENDIF
  ENDPROC

  TRAP Tick
    nLife := (nLife + 1) MOD 30000;
    IF nHeart = nHeartBefore THEN
      nSilent := nSilent + 1;
    ELSE
      nHeartBefore := nHeart;
      nSilent := 0;
    ENDIF
    IF nState = 2 AND nSilent > 4 THEN
      nStop := 1;
    ENDIF
    IF nState = 2 AND nStop <> 0 THEN
      StopMove;
      ClearPath;
      StartMove;
      nState := 3;
      nAck := nReq;
      ExitCycle;  ! the program begins again at main, and waits there until nStop is 0
    ENDIF
  ENDTRAP
ENDMODULE
