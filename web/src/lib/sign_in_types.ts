// Who is signed in, as the service describes it.

export type Role = "viewer" | "technician" | "engineer" | "admin";
export type Right = "see" | "stop" | "run" | "change_limits" | "write_alone" | "make_programs" | "identify";

export interface Person {
  name: string;
  role: Role;
  locked: boolean;
  alone: boolean;
  rights: Right[];
}

/** What the service asks for before this browser may be used, and the person who is signed in. */
export interface SignInState {
  wanted: "device" | "person" | "pin" | "nothing";
  person: Person | null;
}
