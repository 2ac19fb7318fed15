/* The ledger of one robot's memory: how far each robot's closings are held, and those of the last rounds as they came.

   Its columns are ledger.py's, an entry for each robot. Noted here are the words by the present view, and with them those
   closings that come next. All else is left to Python (memory.py), which does the same to these where there is no
   compiler. What a word says was sealed with the fleet's key and may be anything all the same.

   There are DEPTH rows for each robot. That of robot p's round r is there iff floor[p] < r <= held[p] and held[p] - DEPTH
   < r; the silence of several rounds is in the row of each. Allocates nothing. The compiler is told by gate.py: DEPTH, ROW (bytes), MAX_ROBOTS, MOST_WRITES. C99. */

#include <stdint.h>
#include <string.h>

enum { INDICES = 65536, CLOSING_FIELDS = 9, WRITE_FIELDS = 3 };
enum { OPEN, LAST, TICK, APPLIED, SETTLED, LACKING, WATCHED, REACHED, TOLD, NEXT, LEAST, PRESENT, WANTING }; /* of `number` */

typedef struct { /* see ledger.py */
    int64_t *held, *floor, *view, *incarnation, *applied, *through, *heard;
    uint8_t *wanting, *gap;
    int64_t *number;
    int64_t *lacks;  /* of each robot, what it held of each one's when it said that it lacks something */
    uint8_t *rows;   /* DEPTH of ROW bytes for each robot */
    int32_t *length; /* of each row */
    int32_t robots, own;
} Ledger;

typedef struct { /* wire.Round, as far as gate.c reads it */
    int32_t pid;
    int64_t sequence, sent, fleet, view, round, applied, settled;
    int known; /* whether there is a `fleet` */
    int echoed; /* whether there is an echo of ours: of what we `uttered`, which the peer `heard` */
    int64_t uttered, heard;
    Text held, closings; /* as they came */
} Word;

typedef struct { /* wire.Closing, up to its writes, of which there are so many */
    int64_t author, incarnation, first, round, lock;
    int stopped, acted, prompt, writes;
} Closing;

typedef struct { /* wire.Write */
    int64_t index;
    Text value;
    int patch;
} Write;

typedef struct { /* a row that is being collected: its next write; index INDICES: there is none */
    Reader reader;
    Closing closing;
    Write write;
} Cursor;

static int truth(Reader *reader, int *value) {
    if (reader->at >= reader->end || (*reader->at & 0xfe) != 0xc2) return 0;
    *value = *reader->at++ & 1;
    return 1;
}

static int read_closing(Reader *reader, Closing *closing) {
    if (!byte(reader, 0x90 + CLOSING_FIELDS) || !natural(reader, &closing->author) || closing->author >= MAX_ROBOTS)
        return 0;
    if (!natural(reader, &closing->incarnation) || !natural(reader, &closing->first) || !natural(reader, &closing->round))
        return 0;
    if (!truth(reader, &closing->stopped) || !truth(reader, &closing->acted) || !truth(reader, &closing->prompt)) return 0;
    if (!whole(reader, &closing->lock) || closing->lock < -1 || closing->lock >= INDICES) return 0;
    int head = reader->at < reader->end ? *reader->at++ : 0, bytes = head == 0xdc ? 2 : 0;
    if (reader->end - reader->at < bytes || (head != 0xdc && (head & 0xf0) != 0x90)) return 0;
    closing->writes = bytes ? (int)big(reader->at, bytes) : head & 15;
    reader->at += bytes;
    return closing->writes <= MOST_WRITES;
}

static int read_write(Reader *reader, Write *write) {
    if (!byte(reader, 0x90 + WRITE_FIELDS) || !natural(reader, &write->index) || write->index >= INDICES) return 0;
    write->value.at = reader->at;
    if (!skip(reader)) return 0;
    write->value.bytes = (size_t)(reader->at - write->value.at);
    return truth(reader, &write->patch);
}

/* A closing with its writes; where it lies. */
static int read_whole_closing(Reader *reader, Closing *closing, Text *text) {
    Write write;
    text->at = reader->at;
    if (!read_closing(reader, closing)) return 0;
    for (int i = 0; i < closing->writes; i++)
        if (!read_write(reader, &write)) return 0;
    text->bytes = (size_t)(reader->at - text->at);
    return 1;
}

/* Rows of one round lie side by side. */
static size_t ledger_slot(const Ledger *ledger, int32_t pid, int64_t round) {
    return (size_t)round % DEPTH * (size_t)ledger->robots + (size_t)pid;
}

/* A robot's closing of a round; whether it is here. */
static int ledger_row(const Ledger *ledger, int32_t pid, int64_t round, Text *row) {
    const int64_t held = ledger->held[pid], floor = ledger->floor[pid];
    if (round > held || round <= (floor < held - DEPTH ? held - DEPTH : floor)) return 0;
    const size_t slot = ledger_slot(ledger, pid, round);
    *row = (Text){ledger->rows + slot * ROW, (size_t)ledger->length[slot]};
    return 1;
}

/* Whether a closing, which has so many bytes, is what comes next of its author, and there is room for it: whose places it
   takes must be everyone's, and applied. Of several rounds it says that nothing was done in them. */
static int ledger_follows(const Ledger *ledger, const Closing *closing, size_t bytes) {
    const int64_t pid = closing->author, *number = ledger->number, next = ledger->held[pid] + 1;
    const int silent = !closing->acted && !closing->prompt && !closing->writes && closing->lock < 0;
    int64_t done = number[SETTLED] < number[APPLIED] ? number[SETTLED] : number[APPLIED];
    if (done < ledger->floor[pid]) done = ledger->floor[pid];
    if (closing->incarnation != ledger->incarnation[pid] || closing->stopped || ledger->gap[pid]) return 0;
    if (silent ? closing->first < 1 || closing->first > next : closing->first != next || closing->round != next) return 0;
    return closing->round >= next && closing->round - DEPTH <= done && bytes <= ROW;
}

static void ledger_keep(Ledger *ledger, const Closing *closing, const Text *text) {
    const int32_t pid = (int32_t)closing->author;
    const int64_t before = ledger->held[pid], applied = ledger->number[APPLIED];
    for (int64_t round = before + 1; round <= closing->round; round++) {
        size_t slot = ledger_slot(ledger, pid, round);
        memcpy(ledger->rows + slot * ROW, text->at, text->bytes);
        ledger->length[slot] = (int32_t)text->bytes;
    }
    ledger->held[pid] = closing->round;
    ledger->number[LACKING] -= before <= applied && applied < closing->round;
}

/* What a word's sender holds, by pid; nothing (0 of them): everyone's up to what it has applied. -1: that cannot be. */
static int ledger_told(const Ledger *ledger, const Word *word, int64_t *held) {
    Reader reader = {word->held.at, word->held.at + word->held.bytes}; /* a whole value */
    int64_t last = ledger->number[LAST];
    int parts = *reader.at++;
    if (word->applied > last || word->settled > last || word->round - 1 > last) return -1;
    if (parts == 0xdc) parts = (int)big(reader.at, 2), reader.at += 2;
    else parts = (parts & 0xf0) == 0x90 ? parts & 15 : -1;
    if (parts && parts != ledger->robots) return -1;
    for (int i = 0; i < parts; i++)
        if (!natural(&reader, &held[i]) || held[i] > last) return -1;
    return reader.at == reader.end ? parts : -1;
}

/* Words.hear, of one that goes by the present view and does not ask; `held` as it told. */
static void ledger_hear(Ledger *ledger, const Word *word, const int64_t *held, int parts) {
    int64_t *number = ledger->number, watched = number[WATCHED], through = word->round ? word->round - 1 : 0;
    const int32_t pid = word->pid;
    if (word->view >= ledger->view[pid] && word->applied >= ledger->applied[pid]) {
        int64_t before = ledger->view[pid] == word->view ? ledger->applied[pid] : -1;
        number[REACHED] += word->applied >= watched && watched > before;
        ledger->view[pid] = word->view;
        ledger->applied[pid] = word->applied;
    }
    if (through <= ledger->through[pid]) return;
    ledger->through[pid] = through;
    int64_t *lacks = ledger->lacks + (size_t)pid * (size_t)ledger->robots, least = word->applied;
    for (int i = 0; i < parts; i++) least = !i || held[i] < least ? held[i] : least;
    const uint8_t wanting = least < through;
    number[WANTING] += wanting - ledger->wanting[pid];
    ledger->wanting[pid] = wanting;
    for (int i = 0; wanting && i < ledger->robots; i++) lacks[i] = parts ? held[i] : word->applied;
}

/* Go through the closings of a word, whoever wrote them; 0: one is none, or is new and not what comes next. Those before
   it are kept then, if any are to be `kept`. */
static int ledger_take(Ledger *ledger, const Text *closings, int kept) {
    Reader reader = {closings->at, closings->at + closings->bytes};
    int count = *reader.at++;
    if (count == 0xdc) count = (int)big(reader.at, 2), reader.at += 2;
    else if ((count & 0xf0) == 0x90) count &= 15;
    else return 0;
    for (; count; count--) {
        Closing closing;
        Text text;
        if (!read_whole_closing(&reader, &closing, &text) || closing.author >= ledger->robots) return 0;
        if (!kept || closing.round <= ledger->held[closing.author]) continue;
        if (closing.author == ledger->own || closing.round > ledger->number[LAST]) return 0;
        if (!ledger_follows(ledger, &closing, text.bytes)) return 0;
        ledger_keep(ledger, &closing, &text);
    }
    return 1;
}

/* Note a usual word; 0: there is more to it. Closings of it may be kept then, and are known when Python takes it. */
static int ledger_note(Ledger *ledger, const Word *word) {
    int64_t *number = ledger->number, held[MAX_ROBOTS];
    const int parts = number[OPEN] ? ledger_told(ledger, word, held) : -1;
    if (parts < 0 || !ledger_take(ledger, &word->closings, 0) || !ledger_take(ledger, &word->closings, 1)) return 0;
    ledger_hear(ledger, word, held, parts);
    ledger->heard[word->pid] = number[TICK];
    if (number[TOLD] < word->settled) number[TOLD] = word->settled;
    return 1;
}

/* On to the next write of a row; whether it can be collected: no patch, and behind those before it. */
static int ledger_advance(Cursor *cursor) {
    int64_t before = cursor->write.index;
    if (!cursor->closing.writes) {
        cursor->write.index = INDICES;
        return cursor->reader.at == cursor->reader.end;
    }
    cursor->closing.writes--;
    return read_write(&cursor->reader, &cursor->write) && !cursor->write.patch && cursor->write.index > before;
}

/* Begin with a robot's row; whether it is there and can be collected. */
static int ledger_begin(const Ledger *ledger, int32_t pid, int64_t round, Cursor *cursor) {
    Text row;
    if (!ledger_row(ledger, pid, round, &row)) return 0;
    cursor->reader = (Reader){row.at, row.at + row.bytes};
    if (!read_closing(&cursor->reader, &cursor->closing) || cursor->closing.lock >= 0) return 0;
    cursor->write.index = -1;
    return ledger_advance(cursor);
}

/* The head of an array of less than 2^16. */
static uint8_t *put_head(uint8_t *at, int parts) {
    if (parts < 16) return *at = (uint8_t)(0x90 | parts), at + 1;
    *at++ = 0xdc;
    *at++ = (uint8_t)(parts >> 8);
    *at++ = (uint8_t)parts;
    return at;
}

/* [index, [pids], [values]] of the least variable that is left; 0: its writes cannot be collected. `found`: whether one
   was left. */
static uint8_t *ledger_gather(Cursor *cursors, int rows, uint8_t *at, int *found) {
    int64_t least = INDICES;
    int writers = 0;
    for (int i = 0; i < rows; i++) {
        if (cursors[i].write.index < least) least = cursors[i].write.index, writers = 0;
        writers += cursors[i].write.index == least;
    }
    *found = least < INDICES;
    if (!*found) return at;
    *at++ = 0x93;
    at = put_head(shortest(at, least), writers);
    for (int i = 0; i < rows; i++)
        if (cursors[i].write.index == least) *at++ = (uint8_t)cursors[i].closing.author;
    at = put_head(at, writers);
    for (int i = 0; i < rows; i++) {
        if (cursors[i].write.index != least) continue;
        at = copy(at, &cursors[i].write.value);
        if (!ledger_advance(&cursors[i])) return NULL;
    }
    return at;
}

/* The pids of those who acted, and of those who wait to hear that the round was applied. */
static uint8_t *ledger_pids(const Cursor *cursors, int rows, uint8_t *at) {
    int acted = 0, prompt = 0;
    for (int i = 0; i < rows; i++) acted += cursors[i].closing.acted, prompt += cursors[i].closing.prompt;
    at = put_head(at, acted);
    for (int i = 0; i < rows; i++)
        if (cursors[i].closing.acted) *at++ = (uint8_t)cursors[i].closing.author;
    at = put_head(at, prompt);
    for (int i = 0; i < rows; i++)
        if (cursors[i].closing.prompt) *at++ = (uint8_t)cursors[i].closing.author;
    return at;
}

/* How many members lack the round behind this one, and how far the others have applied in the present view. */
static void ledger_look(Ledger *ledger, int64_t round) {
    int64_t *number = ledger->number, least = INT64_MAX;
    number[NEXT] = 0;
    for (int32_t pid = 0; pid < ledger->robots; pid++) {
        if (ledger->incarnation[pid] < 0) continue;
        number[NEXT] += ledger->held[pid] <= round;
        int64_t applied = ledger->view[pid] == number[PRESENT] ? ledger->applied[pid] : -1;
        if (pid != ledger->own && applied < least) least = applied;
    }
    number[LEAST] = least < INT64_MAX ? least : round;
}

size_t ledger_size(void) { return sizeof(Ledger); }

/* Bytes that ledger_collect may write. It repeats pids and writes of the rows: of a pid 1 byte for each of two lists, of
   a write index and value, beside which it writes 4 bytes where the row has 2, so 2 more, and a write has 4 or more. */
size_t ledger_room(int32_t robots) { return (size_t)robots * (ROW + ROW / 2 + 2) + 12; }

/* All closings of a round as MessagePack, by variable: ledger.Collected. How many bytes; 0: they are not all here, or
   such as only Python applies. */
int32_t ledger_collect(Ledger *ledger, int64_t round, uint8_t *out) {
    Cursor cursors[MAX_ROBOTS];
    int rows = 0, found = 1;
    uint32_t variables = 0;
    for (int32_t pid = 0; pid < ledger->robots; pid++)
        if (ledger->incarnation[pid] >= 0 && !ledger_begin(ledger, pid, round, &cursors[rows++])) return 0;
    uint8_t *at = out, *count;
    *at++ = 0x93;
    count = at = ledger_pids(cursors, rows, at);
    at += 5;
    for (;; variables++) {
        at = ledger_gather(cursors, rows, at, &found);
        if (!at) return 0;
        if (!found) break;
    }
    *count++ = 0xdd;
    for (int i = 24; i >= 0; i -= 8) *count++ = (uint8_t)(variables >> i);
    ledger_look(ledger, round);
    return (int32_t)(at - out);
}

/* Keep an own closing, which has so many bytes. 0: it is not the next, or there is no room. */
int32_t ledger_close(Ledger *ledger, const uint8_t *row, int32_t bytes) {
    Reader reader = {row, row + (bytes > 0 ? bytes : 0)};
    Closing closing;
    Text text;
    if (!ledger->number[OPEN] || !read_whole_closing(&reader, &closing, &text) || reader.at != reader.end) return 0;
    if (closing.author != ledger->own || !ledger_follows(ledger, &closing, text.bytes)) return 0;
    ledger_keep(ledger, &closing, &text);
    return 1;
}
