/* Puts damaged datagrams with right MACs through the gate, under the compiler's sanitizers: gate.c is compiled together
   with this. What is noted of them in a ledger is collected, amid own closings. Arguments: how many datagrams, and the
   seed. Exit status 0 when nothing was read or written beyond its end, the rows are as many as the verdicts tell, each
   of them is MessagePack of six, no robot teaches twice before it is asked, and what is collected is MessagePack of three. */

#include "gate.c"

#include <stdio.h>
#include <stdlib.h>

enum { ROBOTS = 128, OWN = 5, BATCH = 200, MOST = LIMIT - MAC_SIZE };

static int64_t naturals[5][ROBOTS];
static uint64_t words[ROBOTS * WORDS], buckets[ROBOTS * BUCKETS];
static int64_t received[ROBOTS], expected[ROBOTS];
static int64_t lessons;
static double times[4][ROBOTS];
static uint8_t room[1 << 20]; /* for what is longer than a datagram */
static Ledger ledger;
static int members, quiet; /* so many were noted */
static const uint8_t key[32] = {1, 2, 3}, begins[] = {3, 0x99, 1, 0x9a, 7};

static void check(int good, const char *what) {
    if (!good) {
        fprintf(stderr, "%s\n", what);
        exit(1);
    }
}

static int below(int most) { return rand() % most; }

/* A number, in any of its encodings. */
static uint8_t *number(uint8_t *at) {
    int bytes = 1 << below(4);
    if (below(2)) return *at = (uint8_t)below(128), at + 1;
    *at++ = (uint8_t)(0xcc + below(2) * 4 + (bytes > 1) + (bytes > 2) + (bytes > 4));
    for (int i = 0; i < bytes; i++) *at++ = (uint8_t)(i < 2 && bytes == 8 ? 0 : rand());
    return at;
}

static uint8_t *small(uint8_t *at, int value) { return *at++ = 0xcc, *at++ = (uint8_t)value, at; }

/* Anything, with heads whose lengths may be wrong. */
static uint8_t *value(uint8_t *at, int depth) {
    int kind = below(6), parts = below(4);
    if (kind == 0 || depth > 6) return number(at);
    if (kind == 1) return *at++ = (uint8_t)(0xa0 + parts), memset(at, 'a', (size_t)parts), at + parts;
    if (kind == 2 && below(8)) return *at++ = 0xc3, at;
    if (kind == 2) return *at++ = (uint8_t)(0xc0 + below(32)), memset(at, below(256), (size_t)parts), at + parts;
    if (kind == 3) return *at++ = 0xd9, *at++ = (uint8_t)(below(30) ? 20 : below(40)), memset(at, 'b', 20), at + 20;
    *at++ = (uint8_t)(kind == 4 ? 0x90 + parts : 0x80 + parts);
    for (int i = 0; i < parts * (kind == 4 ? 1 : 2); i++) at = value(at, depth + 1);
    return at;
}

/* The writes of a closing, nearly always as they should be: in its room. */
static uint8_t *make_writes(uint8_t *at) {
    int count = below(3) ? below(4) : below(20), index = 0;
    if (!below(20)) count = below(260), *at++ = 0xdc, *at++ = (uint8_t)(count >> 8), *at++ = (uint8_t)count;
    else if (count < 16) *at++ = (uint8_t)(0x90 + count);
    else *at++ = 0xdc, *at++ = 0, *at++ = (uint8_t)count;
    for (; count; count--) {
        *at++ = 0x93;
        at = shortest(at, index += 1 + below(3) * below(200));
        at = below(10) ? number(at) : value(at, 5);
        *at++ = below(2000) ? 0xc2 : 0xc3;
    }
    return at;
}

/* What the ledger notes, but for what chance has damaged. */
static uint8_t *make_closing(uint8_t *at, int pid) {
    int64_t round = ledger.held[pid] + (below(12) ? 1 : below(5) - 2);
    *at++ = 0x99;
    at = shortest(shortest(at, below(30) ? pid : below(ROBOTS)), below(30) ? 9 : below(300));
    const int64_t first = below(6) ? round : round - below(4);
    at = shortest(shortest(at, below(30) && first > 0 ? first : below(30)), round);
    for (int i = 0; i < 3; i++) *at++ = (uint8_t)(0xc2 + (i && below(2)));
    return make_writes(shortest(at, below(400) ? -1 : below(70000) - 2));
}

/* What somebody who lacks something holds, now and then of one too many. */
static uint8_t *make_held(uint8_t *at) {
    const int parts = ROBOTS + !below(50);
    *at++ = 0xdc, *at++ = (uint8_t)(parts >> 8), *at++ = (uint8_t)parts;
    for (int i = 0; i < parts; i++) *at++ = (uint8_t)below(60);
    return at;
}

/* A word that is usual but for what chance has damaged; how long its payload is. */
static int make(uint8_t *payload, int32_t sequence) {
    int pid = below(20) ? below(below(3) ? members : ROBOTS) : below(256), round = below(256);
    const int plain = below(3) && pid < ROBOTS, echoes = plain && below(8) ? 0 : below(3); /* may be noted */
    uint8_t *at = payload;
    memcpy(at, begins, sizeof begins), at += sizeof begins;
    *at++ = (uint8_t)pid;
    memset(at, pid, TAIL), at += TAIL;
    *at++ = 0xce;
    for (int i = 24; i >= 0; i -= 8) *at++ = (uint8_t)(sequence >> i);
    at = plain ? small(at, 3) : number(at);
    if (!plain && below(3)) at = number(at);
    else *at++ = 0xc0;
    *at++ = (uint8_t)(0x90 + echoes);
    for (int i = 0; i < echoes; i++) *at++ = 0x93, at = number(number(small(at, below(3) ? OWN : below(ROBOTS))));
    at = small(small(at, 1), plain ? below(4) : round);
    if (plain) at = shortest(shortest(at, 9 - !below(9)), below(9));
    else at = number(number(at));
    *at++ = below(30) ? 0xc2 : 0xc3;
    if (plain && !below(4)) at = make_held(at);
    else if (plain || below(2)) *at++ = 0x90;
    else at = value(at, 0);
    int closings = plain ? (below(9) > 0) + (below(5) ? 0 : below(4)) : below(3);
    *at++ = (uint8_t)(0x90 + closings);
    for (int i = 0; i < closings && plain; i++) at = make_closing(at, i ? below(ROBOTS) : pid);
    for (int i = 0; i < closings && !plain; i++) {
        *at++ = 0x99;
        at = small(small(small(small(at, pid), 9), round), round);
        for (int j = 0; j < 5; j++) at = value(at, j);
    }
    int length = (int)(at - payload);
    if (length > MOST) length = MOST;
    for (int flips = below(plain ? 8 : 4) ? 0 : 1 + below(6); flips; flips--) payload[below(length)] = (uint8_t)rand();
    if (!below(plain ? 40 : 8)) length = below(length + 1);
    return length;
}

/* The MAC goes behind the payload. */
static int32_t close_up(const Gate *gate, uint8_t *datagram, int length) {
    make_mac(&gate->keyed, datagram, length, datagram + length);
    return length + MAC_SIZE;
}

/* Whether what was told is what its length says; how many rows it has. */
static uint32_t look(const Shown *shown, int count) {
    uint32_t rows = 0, usual = 0;
    int others = 0;
    for (int i = 0; i < count; i++) {
        check(shown->verdict[i] <= NOTED, "verdict");
        usual += shown->verdict[i] == USUAL, quiet += shown->verdict[i] == NOTED;
        others += shown->verdict[i] != USUAL && shown->verdict[i] != NOTHING && shown->verdict[i] != NOTED;
    }
    check(others == shown->others, "others");
    if (!usual) return check(!shown->bytes, "bytes of nothing"), 0;
    Reader reader = {shown->rows + 5, shown->rows + shown->bytes};
    for (; reader.at < reader.end; rows++) check(*reader.at == 0x96 && skip(&reader), "row");
    check(rows == usual && shown->rows[0] == 0xdd && big(shown->rows + 1, 4) == rows, "rows");
    return rows;
}

/* What the clock learns; how much. */
static int64_t learn_all(Shown *shown) {
    const int64_t found = lessons;
    int told[ROBOTS] = {0};
    check(found >= 0 && found <= ROBOTS, "lessons");
    for (int64_t i = 0; i < found; i++) {
        const int64_t pid = shown->lesson[i].pid;
        check(pid >= 0 && pid < ROBOTS && !told[pid]++, "lesson");
        times[3][pid] = below(3) ? 0 : 100;
    }
    return lessons = 0, found;
}

static void *fresh(void *old, size_t bytes) {
    free(old);
    void *found = calloc(bytes, 1);
    return check(found != NULL, "no memory"), found;
}

/* A ledger, whose columns have exactly the room that they need. */
static void begin_ledger(void) {
    int64_t **const columns[] = {&ledger.held, &ledger.floor, &ledger.view, &ledger.incarnation, &ledger.applied,
                                 &ledger.through, &ledger.heard};
    for (int i = 0; i < 7; i++) *columns[i] = fresh(*columns[i], ROBOTS * sizeof(int64_t));
    ledger.wanting = fresh(ledger.wanting, ROBOTS), ledger.gap = fresh(ledger.gap, ROBOTS);
    ledger.number = fresh(ledger.number, (WANTING + 1) * sizeof(int64_t));
    ledger.lacks = fresh(ledger.lacks, (size_t)ROBOTS * ROBOTS * sizeof(int64_t));
    ledger.rows = fresh(ledger.rows, (size_t)ROBOTS * DEPTH * ROW);
    ledger.length = fresh(ledger.length, ROBOTS * DEPTH * sizeof(int32_t));
    ledger.robots = ROBOTS, ledger.own = OWN;
}

/* What Python does to its columns before datagrams come; robots up to `members` count. */
static void change_ledger(void) {
    const int64_t applied = ledger.number[APPLIED];
    ledger.number[OPEN] = below(30) > 0, ledger.number[LAST] = applied + 600, ledger.number[WATCHED] = applied;
    if (!members || !below(4)) members = 2 + below(below(8) ? 9 : ROBOTS - 2);
    for (int pid = 0; pid < ROBOTS; pid++) {
        ledger.incarnation[pid] = pid % 30 && pid < members ? 9 : -1; /* others are not adopted */
        ledger.applied[pid] = below(6);
        if (ledger.held[pid] < applied) ledger.held[pid] = ledger.floor[pid] = applied;
        ledger.view[pid] = below(400) > 0, ledger.gap[pid] = !below(400), ledger.wanting[pid] = !below(400);
    }
}

/* Closings that end anywhere: not a byte behind them may be read. */
static void cut(void) {
    const size_t whole = (size_t)(make_closing(room, below(ROBOTS)) - room);
    for (size_t bytes = 1; bytes < whole && bytes < 60; bytes++) {
        uint8_t *exact = fresh(NULL, bytes);
        Reader reader = {exact, exact + bytes};
        Text text;
        Closing closing;
        memcpy(exact, room, bytes);
        check(!read_whole_closing(&reader, &closing, &text), "cut");
        free(exact);
    }
}

/* Own closings, and rounds as far as they can be collected; also such as are not here. How many could be. */
static int collect(void) {
    int found = 0;
    for (int i = 0; i < 30; i++) {
        uint8_t *out = malloc(ledger_room(ROBOTS));
        const int32_t whole = (int32_t)(make_closing(room, OWN) - room), bytes = below(9) ? whole : below(whole);
        uint8_t *exact = fresh(NULL, (size_t)bytes);
        memcpy(exact, room, (size_t)bytes);
        ledger_close(&ledger, exact, bytes);
        int64_t round = below(3) ? ledger.number[APPLIED] + 1 : below(40);
        int32_t size = ledger_collect(&ledger, round, out);
        Reader reader = {out, out + size};
        if (size) check(*out == 0x93 && skip(&reader) && reader.at == reader.end, "collected"), found++;
        if (size || !below(60)) ledger.number[APPLIED]++, ledger.number[SETTLED]++;
        free(exact), free(out);
    }
    return found;
}

static void begin(Gate *gate, uint8_t *rows, uint32_t key_bytes) {
    const uint8_t purpose[PURPOSE] = {'t', 'e', 's', 't'};
    Columns columns = {naturals[0], naturals[1], naturals[2], naturals[3], words, received,
                       expected,    times[0],    times[1],    buckets,     times[2],    times[3],    &lessons};
    gate_open(gate, ROBOTS, OWN, &columns, rows, key, key_bytes, purpose);
    gate_begin(gate, begins, sizeof begins);
    for (int pid = 0; pid < ROBOTS; pid++) {
        uint8_t tail[TAIL];
        memset(tail, pid, TAIL);
        gate_adopt(gate, pid, tail, pid % 30 ? TAIL : 12);
    }
    gate_follow(gate, 1);
    begin_ledger();
    change_ledger();
    for (int pid = 0; pid < ROBOTS; pid++) times[3][pid] = 0;
    gate_attach(gate, below(9) ? &ledger : NULL);
}

/* One alone, of which not a byte too many may be read. */
static uint32_t take_one(Gate *gate, const uint8_t *datagram, int32_t length) {
    uint8_t *exact = malloc((size_t)length);
    memcpy(exact, datagram, (size_t)length);
    gate_take(gate, exact, LARGEST, &length, 1, 12.5, below(2) ? 1e3 : NAN);
    free(exact);
    return look(&gate->shown, 1);
}

int main(int count, char **arguments) {
    check(count == 3, "usage: gate_driver DATAGRAMS SEED");
    const int todo = atoi(arguments[1]);
    uint32_t usual = 0;
    int collected = 0;
    int64_t learned = 0;
    Gate *gate = malloc(gate_size());
    uint8_t *rows = malloc((size_t)MOST_AT_ONCE * (LARGEST + 32)), *slots = calloc(MOST_AT_ONCE, LARGEST);
    int32_t *lengths = malloc(MOST_AT_ONCE * sizeof *lengths);
    srand((unsigned)atoi(arguments[2]));
    for (int done = 0, turn = 0, batch; done < todo; done += batch, turn++) {
        if (turn % 100 == 0) begin(gate, rows, below(2) ? sizeof key : 0);
        batch = turn % 50 ? BATCH : MOST_AT_ONCE;
        for (int i = 0; i < batch; i++) {
            uint8_t *made = room;
            int payload = make(made, 5000 + done + i - below(below(9) ? 9 : 1500));
            lengths[i] = close_up(gate, made, payload);
            if (!below(50)) made[below(lengths[i])] ^= 1;
            if (!below(50)) lengths[i] = below(2) ? -1 : below(4) ? below(LARGEST + 1) : 2 * MOST_AT_ONCE * LARGEST;
            memcpy(slots + (size_t)i * LARGEST, made, LARGEST);
            if (lengths[i] > 0 && lengths[i] <= LARGEST) usual += take_one(gate, made, lengths[i]);
        }
        memset(words, 0, sizeof words), memset(naturals[0], 0, sizeof naturals[0]);
        gate_take(gate, slots, LARGEST, lengths, batch, 12.5, 1e3);
        usual += look(&gate->shown, batch);
        learned += learn_all(&gate->shown);
        cut();
        collected += collect();
        change_ledger();
        memset(words, 0, sizeof words), memset(naturals[0], 0, sizeof naturals[0]); /* damaged numbers are high */
    }
    check(usual > (uint32_t)todo / 5, "hardly any was usual");
    check(quiet > todo / 10, "hardly any was noted");
    check(learned > todo / 100, "hardly anything was learned");
    check(collected > todo / 200, "hardly any round was collected");
    free(lengths), free(slots), free(rows), free(gate);
    return 0;
}
