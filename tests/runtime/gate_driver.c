/* Puts damaged datagrams with right MACs through the gate, under the compiler's sanitizers: gate.c is compiled together
   with this. Arguments: how many datagrams, and the seed. Exit status 0 when nothing was read or written beyond its end,
   the rows are as many as the verdicts tell, and each of them is MessagePack of seven. */

#include "gate.c"

#include <stdio.h>
#include <stdlib.h>

enum { ROBOTS = 128, OWN = 5, BATCH = 200, MOST = LIMIT - MAC_SIZE };

static int64_t naturals[5][ROBOTS];
static uint64_t words[ROBOTS * WORDS], buckets[ROBOTS * BUCKETS];
static int64_t received[ROBOTS], expected[ROBOTS];
static double times[3][ROBOTS];
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

/* A word that is usual but for what chance has damaged; how long its payload is. */
static int make(uint8_t *payload, int32_t sequence) {
    int pid = below(20) ? below(ROBOTS) : below(256), round = below(256), echoes = below(3);
    uint8_t *at = payload;
    memcpy(at, begins, sizeof begins), at += sizeof begins;
    *at++ = (uint8_t)pid;
    memset(at, pid, TAIL), at += TAIL;
    *at++ = 0xce;
    for (int i = 24; i >= 0; i -= 8) *at++ = (uint8_t)(sequence >> i);
    at = number(at);
    if (below(3)) at = number(at);
    else *at++ = 0xc0;
    *at++ = (uint8_t)(0x90 + echoes);
    for (int i = 0; i < echoes; i++) *at++ = 0x93, at = number(number(small(at, below(ROBOTS))));
    at = number(number(small(small(at, 1), round)));
    *at++ = below(30) ? 0xc2 : 0xc3;
    if (below(2)) *at++ = 0x90;
    else at = value(at, 0);
    int closings = below(3);
    *at++ = (uint8_t)(0x90 + closings);
    for (int i = 0; i < closings; i++) {
        *at++ = 0x99;
        at = small(small(small(small(at, pid), 9), round), round);
        for (int j = 0; j < 5; j++) at = value(at, j);
    }
    int length = (int)(at - payload);
    if (length > MOST) length = MOST;
    for (int flips = below(4) ? 0 : 1 + below(6); flips; flips--) payload[below(length)] = (uint8_t)rand();
    if (!below(8)) length = below(length + 1);
    return length;
}

/* The MAC goes behind the payload. */
static int32_t close_up(const Gate *gate, uint8_t *datagram, int length) {
    uint32_t hash[8], count = gate->keyed_bytes;
    uint8_t block[BLOCK] = {0}, *at = datagram;
    int rest = length;
    memcpy(hash, gate->keyed, sizeof hash);
    for (; rest > BLOCK; rest -= BLOCK, at += BLOCK) compress(hash, at, count += BLOCK, 0);
    memcpy(block, at, (size_t)rest);
    compress(hash, block, count + (uint32_t)rest, 1);
    for (int i = 0; i < MAC_SIZE; i++) datagram[length + i] = (uint8_t)(hash[i / 4] >> i % 4 * 8);
    return length + MAC_SIZE;
}

/* Whether what was told is what its length says; how many rows it has. */
static uint32_t look(const Shown *shown, int count) {
    uint32_t rows = 0, usual = 0;
    int others = 0;
    for (int i = 0; i < count; i++) {
        check(shown->verdict[i] <= NOTHING, "verdict");
        usual += shown->verdict[i] == USUAL;
        others += shown->verdict[i] != USUAL && shown->verdict[i] != NOTHING;
    }
    check(others == shown->others, "others");
    if (!usual) return check(!shown->bytes, "bytes of nothing"), 0;
    Reader reader = {shown->rows + 5, shown->rows + shown->bytes};
    for (; reader.at < reader.end; rows++) check(*reader.at == 0x97 && skip(&reader), "row");
    check(rows == usual && shown->rows[0] == 0xdd && big(shown->rows + 1, 4) == rows, "rows");
    return rows;
}

static void begin(Gate *gate, uint8_t *rows, uint32_t key_bytes) {
    const uint8_t purpose[PURPOSE] = {'t', 'e', 's', 't'};
    Columns columns = {naturals[0], naturals[1], naturals[2], naturals[3], words, received,
                       expected,    times[0],    times[1],    buckets,     times[2]};
    gate_open(gate, ROBOTS, OWN, &columns, rows, key, key_bytes, purpose);
    gate_begin(gate, begins, sizeof begins);
    for (int pid = 0; pid < ROBOTS; pid++) {
        uint8_t tail[TAIL];
        memset(tail, pid, TAIL);
        gate_adopt(gate, pid, tail, pid % 30 ? TAIL : 12);
    }
    gate_follow(gate, 1);
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
    Gate *gate = malloc(gate_size());
    uint8_t *rows = malloc((size_t)MOST_AT_ONCE * (LARGEST + 32)), *slots = calloc(MOST_AT_ONCE, LARGEST);
    int32_t *lengths = malloc(MOST_AT_ONCE * sizeof *lengths);
    srand((unsigned)atoi(arguments[2]));
    for (int done = 0, batch; done < todo; done += batch) {
        if (done % (100 * BATCH) == 0) begin(gate, rows, below(2) ? sizeof key : 0);
        batch = done % (50 * BATCH) ? BATCH : MOST_AT_ONCE;
        for (int i = 0; i < batch; i++) {
            uint8_t made[4 * LARGEST];
            int payload = make(made, 5000 + done + i - below(below(9) ? 9 : 1500));
            lengths[i] = close_up(gate, made, payload);
            if (!below(50)) made[below(lengths[i])] ^= 1;
            if (!below(50)) lengths[i] = below(2) ? -1 : below(LARGEST + 1);
            memcpy(slots + (size_t)i * LARGEST, made, LARGEST);
            if (lengths[i] > 0) usual += take_one(gate, made, lengths[i]);
        }
        memset(words, 0, sizeof words);
        gate_take(gate, slots, LARGEST, lengths, batch, 12.5, 1e3);
        usual += look(&gate->shown, batch);
    }
    check(usual > (uint32_t)todo / 5, "hardly any was usual");
    free(lengths), free(slots), free(rows), free(gate);
    return 0;
}
