/* Lets the gate say words that may be too long, too short, or out of rows that are not there, under the compiler's
   sanitizers: gate.c is compiled together with this. Arguments: how many words, and the seed. Exit status 0 when nothing
   was read or written beyond its end, and what was said is genuine and as long as its parts. */

#include "gate.c"

#include <stdio.h>
#include <stdlib.h>

enum { ROBOTS = 5, OWN = 3 };

static int64_t columns[7][ROBOTS], number[16];
static uint8_t flags[2][ROBOTS];

static void check(int good, const char *what) {
    if (!good) {
        fprintf(stderr, "%s\n", what);
        exit(1);
    }
}

static int below(int most) { return rand() % most; }

/* A length, often near the one with which a datagram is full. */
static int32_t some(int32_t left) {
    if (below(3) == 0) return left - 4 + below(8);
    return below(4) ? below(80) : below(2 * LIMIT);
}

/* Text that ends where its memory does. */
static uint8_t *exactly(int32_t bytes, int first) {
    uint8_t *made = malloc(bytes > 0 ? (size_t)bytes : 1);
    if (bytes > 0) memset(made, below(256), (size_t)bytes), made[0] = (uint8_t)first;
    return made;
}

static const uint8_t *sent;
static int32_t sent_bytes, sent_to;

static int32_t courier(void *inbox, int32_t place, const uint8_t *datagram, int32_t length) {
    check(inbox == &sent, "called with something else");
    sent = datagram, sent_bytes = length, sent_to = place;
    return place % 3;
}

static double time_now;
static int stamped_here;

static double tick(void) { return time_now; }

/* The same word again, stamped here: as long as its stamps; or none, where only another can make them. */
static void stamp_it(Gate *gate, const uint8_t *fields, int32_t bytes, int64_t own) {
    static const int64_t EDGES[] = {0, 1, 127, 128, 255, 256, 65535, 65536, 4294967295, 4294967296, (int64_t)1 << 53};
    Stamped *stamped = voice_stamped(gate);
    uint8_t *told = exactly(bytes + 3, 0x93), head[4] = {0x93, (uint8_t)below(128), (uint8_t)own, 0x96};
    for (int32_t i = 0; i < bytes + 3; i++) told[i] = i < 4 ? head[i] : fields[i - 3];
    const int64_t before = stamped->sequence = EDGES[below(10)];
    stamped->fleet = below(2) ? EDGES[below(11)] : -EDGES[below(11)], stamped->known = below(3) > 0;
    stamped->until = below(4) ? 1e9 : below(2) ? time_now : -INFINITY;
    time_now = below(3) ? (double)EDGES[below(10)] / 1e6 : -1;
    sent_bytes = 0;
    const int32_t error = voice_send(gate, told, bytes + 3);
    if (stamped->until <= time_now) check(error == NOT_STAMPED && !sent_bytes, "stamped too late");
    else check(error == NOT_POSSIBLE || error == head[1] % 3, "not stamped");
    check(stamped->sequence == before + (error >= 0), "what was not said has a number");
    if (error >= 0) check(sent_bytes && is_genuine(&gate->keyed, sent, sent_bytes), "stamped something else"), stamped_here++;
    free(told);
}

/* The same word again, sent; or one that is cut, which is not. */
static void send_it(Gate *gate, const uint8_t *fields, int32_t bytes, int64_t own, int32_t expected) {
    const int cut = below(4) ? 0 : below(bytes + 4), whole = !cut;
    uint8_t *told = exactly(bytes + 3 - cut, 0x93), head[3] = {0x93, (uint8_t)below(128), (uint8_t)own};
    for (int32_t i = 0; i < bytes + 3 - cut; i++) told[i] = i < 3 ? head[i] : fields[i - 3];
    sent_bytes = 0, voice_stamped(gate)->until = -INFINITY;
    const int32_t error = voice_send(gate, told, bytes + 3 - cut);
    if (whole && expected) check(error == head[1] % 3 && sent_to == head[1] && sent_bytes == expected, "not sent");
    if (whole && !expected) check(error < 0 && !sent_bytes, "sent what cannot be");
    if (sent_bytes) check(sent == voice_said(gate) && is_genuine(&gate->keyed, sent, sent_bytes), "sent something else");
    free(told);
}

/* One word; its length. */
static int32_t say_it(Gate *gate, Ledger *ledger) {
    const int32_t begins = below(5) ? 54 : below(MOST_BEGIN + 3);
    int32_t row = some(LIMIT - MAC_SIZE - begins - 21);
    if (row < 0 || row > ROW) row = 9;
    const int64_t own = below(3) ? 1 + below(60) : 0;
    const int there = own > columns[1][OWN] && own <= columns[0][OWN] && own > columns[0][OWN] - DEPTH;
    const int32_t closing = own && there ? row : 0;
    const int32_t bytes = below(9) ? some(LIMIT - MAC_SIZE - begins - closing) : below(2) - 1;
    const int right = below(9);
    uint8_t *begin = exactly(begins, 3), *fields = exactly(bytes, right ? 0x9a : below(256));
    const int is_word = bytes > 0 && fields[0] == 0x9a && begins && begins <= MOST_BEGIN;
    if (there) ledger->length[ledger_slot(ledger, OWN, own)] = row;
    voice_introduce(gate, begin, begins);
    const int32_t found = voice_say(gate, fields, bytes, below(20) ? ledger : NULL, own);
    const int32_t payload = begins + bytes + closing;
    if (bytes > 0) stamp_it(gate, fields, bytes, own);
    if (bytes >= 0) send_it(gate, fields, bytes, own, voice_say(gate, fields, bytes, ledger, own));
    if (found) check(voice_say(gate, fields, bytes, ledger, own) == found, "says it once only");
    free(begin), free(fields);
    if (!found) return 0;
    check(is_word && (!own || there) && payload <= LIMIT - MAC_SIZE, "said what cannot be");
    check(found == payload + MAC_SIZE && is_genuine(&gate->keyed, voice_said(gate), found), "said something else");
    return found;
}

int main(int count, char **arguments) {
    check(count == 3, "usage: voice_driver WORDS SEED");
    const int todo = atoi(arguments[1]);
    const uint8_t key[32] = {1, 2, 3}, purpose[PURPOSE] = {'t', 'e', 's', 't'};
    int32_t *length = calloc(ROBOTS * DEPTH, sizeof *length);
    uint8_t *rows = malloc((size_t)ROBOTS * DEPTH * ROW);
    int64_t *lacks = calloc((size_t)ROBOTS * ROBOTS, sizeof *lacks);
    Columns none = {0};
    Ledger ledger = {columns[0], columns[1], columns[2], columns[3], columns[4], columns[5], columns[6],
                     flags[0],   flags[1],   number,     lacks,      rows,       length,     ROBOTS,     OWN};
    Gate *gate = malloc(gate_size());
    int said = 0, full = 0;
    srand((unsigned)atoi(arguments[2]));
    memset(rows, 0x99, (size_t)ROBOTS * DEPTH * ROW);
    gate_open(gate, ROBOTS, OWN, &none, NULL, key, sizeof key, purpose);
    gate_attach(gate, &ledger);
    voice_couple(gate, courier, &sent, tick);
    for (int done = 0; done < todo; done++) {
        columns[0][OWN] = below(60);
        columns[1][OWN] = columns[0][OWN] - below(12);
        const int32_t found = say_it(gate, &ledger);
        said += found > 0;
        full += found == LIMIT;
    }
    check(said > todo / 10 && full > todo / 500 && stamped_here > todo / 10, "hardly any was said");
    free(gate), free(rows), free(length), free(lacks);
    return 0;
}
