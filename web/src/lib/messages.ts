// Templates and arguments of the texts that the service sent: beside every document stands a table by its English texts.
//
// A document is shown by its texts; their templates are found here by the text. calibration/message.py has
// the same rules.

export interface Message {
  template: string;
  arguments: Record<string, Argument>;
}

export type Argument = string | Message;

const MOST = 20_000; // texts; the oldest are forgotten, never those of the document that is learned
const HOLE = /\{\{|\}\}|\{(\w+)\}/g;
const messagesByText = new Map<string, Message>();

/** Take the tables of a document, or of each of a list, and return it. */
export function learn<T>(document: T): T {
  for (const each of Array.isArray(document) ? document : [document]) {
    const table = Object.entries<Message>(each?.messages ?? {});
    makeRoom(table.length);
    for (const [text, message] of table) remember(text, message);
  }
  return document;
}

function makeRoom(count: number) {
  let over = messagesByText.size + count - MOST;
  for (const text of messagesByText.keys()) {
    if (over-- <= 0) return;
    messagesByText.delete(text);
  }
}

function remember(text: string, message: Message) {
  if (english(message) !== text) return; // it would say something else
  if (Object.values(message.arguments).some((argument) => english(argument) === text)) return; // it would never end
  messagesByText.delete(text);
  messagesByText.set(text, message);
}

/** The message that has this English text. */
export const messageOf = (text: string): Message | undefined => messagesByText.get(text);

/** A text, or the English text of a message. */
export const english = (argument: Argument): string =>
  typeof argument === "string" ? argument : fill(argument.template, (name) => english(argument.arguments[name] ?? ""));

/** A template with its holes filled in. */
export const fill = (template: string, valueOf: (name: string) => string): string =>
  template.replace(HOLE, (found, name?: string) => (name === undefined ? found[0]! : valueOf(name)));

/** A plain text as a catalogue has it. */
export const escaped = (text: string): string => text.replaceAll("{", "{{").replaceAll("}", "}}");

/** Whether nothing of a template is to be translated but what is filled in. */
export const isPunctuation = (template: string): boolean =>
  template.includes("{") && [...fill(template, () => "")].every((letter) => " .,;:\n".includes(letter));
