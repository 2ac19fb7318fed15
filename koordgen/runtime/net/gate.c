/* The gate of one robot's shared memory: which datagrams are genuine and new, and the usual ones' way in.

   Usual is what nearly all datagrams are: the word (wire.Round) of an adopted boot of a peer, in the present view,
   without an emergency. It is checked, counted, and noted in the ledger (ledger.h) where there is one and the word says
   no more than nearly all; else it is handed on as MessagePack (gate.Usual), and whether what it says makes sense is not
   asked here. What the clock learns from it is kept until Python asks, and wakes nobody. All else that is genuine is left
   to Python (link.py), which does the same to the usual ones where there is no compiler; tests compare the two. Nothing of
   a datagram is looked at before its MAC was found right.

   It allocates nothing, and writes only to what its caller, gate.py, gave it: the columns of sessions.py and metrics.py,
   an entry for each robot. The compiler is told by gate.py: LIMIT, LARGEST, MOST_AT_ONCE, MAC_SIZE, MAX_ROBOTS, MAX_ECHOES,
   WORDS, BUCKETS, PER_OCTAVE, RECENT, and what ledger.h wants. C99. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "blake2s.h"
#include "mac.h"
#include "msgpack.h"
#include "ledger.h"
#include "voice.h"

enum { WINDOW = 64 * (WORDS - 1), MOST_COMMON = 64, TAIL = 20, WORD_FIELDS = 9 };
enum { USUAL, OTHER, FALSE, TOO_LONG, REPLAYED, NOTHING, NOTED }; /* verdicts */

static const double SHORTEST = 1e-6; /* s that a histogram tells apart */

typedef struct { /* entries by pid; see sessions.py and metrics.py */
    int64_t *newest, *sent, *arrived, *round;
    uint64_t *seen; /* WORDS of each */
    int64_t *received, *expected;
    double *heard, *longest;
    uint64_t *delays; /* BUCKETS of each */
    double *most;
    double *due; /* before, its echoes teach nothing */
    int64_t *lessons; /* one number: how many are not taken yet, one of a peer at most */
} Columns;

typedef struct { /* in microseconds; see gate.py */
    int64_t pid, answered, uttered, heard, fleet, known, arrived;
} Lesson;

typedef struct { /* what gate.py reads and writes, field by field */
    double local, fleet;           /* of what gate_look judges next, see gate_take */
    int32_t others;                /* datagrams that are not usual */
    int32_t bytes;                 /* of `rows` */
    int32_t past;                  /* whether they are by another view than the present one */
    int32_t count;                 /* of `rows` */
    uint8_t verdict[MOST_AT_ONCE]; /* of each slot */
    uint8_t *rows;                 /* MessagePack: an array of gate.Usual */
    Lesson lesson[MAX_ROBOTS];
} Shown;

typedef struct { /* where the courier leaves what it has received, in so many slots, of which so many are judged */
    const uint8_t *slots;
    const int32_t *lengths, *used;
    int32_t *judged;
} Heard;

typedef struct {
    int32_t adopted;
    uint8_t tail[TAIL]; /* boot and epoch, as they are encoded */
} Peer;

typedef struct {
    Shown shown;
    Keyed keyed;
    Columns columns;
    int32_t robots, own;          /* pid */
    int32_t common_bytes;
    uint8_t common[MOST_COMMON];  /* how a word of this mission begins, up to its sender */
    int64_t view;
    Ledger *ledger;               /* or NULL */
    Heard heard;
    Peer peer[MAX_ROBOTS];
    Voice voice;
} Gate;

/* The echoes in a head, and among them the first of ours. */
static int read_echoes(const Gate *gate, Reader *reader, Word *word) {
    int64_t pid, sent, received;
    word->echoed = 0;
    int count = reader->at < reader->end ? *reader->at++ - 0x90 : -1;
    if (count < 0 || count > MAX_ECHOES) return 0;
    for (; count; count--) {
        if (!byte(reader, 0x93) || !natural(reader, &pid) || !natural(reader, &sent) || !natural(reader, &received))
            return 0;
        if (pid >= MAX_ROBOTS) return 0;
        if (pid != gate->own || word->echoed) continue;
        word->echoed = 1;
        word->uttered = sent;
        word->heard = received;
    }
    return 1;
}

/* Whether this is a usual datagram, whose MAC is right. */
static int read_word(const Gate *gate, const uint8_t *payload, int32_t length, Word *word) {
    const int32_t head = gate->common_bytes;
    if (length < head + 1 + TAIL || !head || memcmp(payload, gate->common, (size_t)head)) return 0;
    word->pid = payload[head];
    if (word->pid >= gate->robots) return 0;
    const Peer *peer = &gate->peer[word->pid];
    if (!peer->adopted || memcmp(payload + head + 1, peer->tail, TAIL)) return 0;
    Reader reader = {payload + head + 1 + TAIL, payload + length};
    if (!natural(&reader, &word->sequence) || !natural(&reader, &word->sent)) return 0;
    word->known = reader.at < reader.end && *reader.at != 0xc0;
    if (!(word->known ? whole(&reader, &word->fleet) : byte(&reader, 0xc0))) return 0;
    if (!read_echoes(gate, &reader, word)) return 0;
    if (!natural(&reader, &word->view) || word->view != gate->view || !natural(&reader, &word->round)) return 0;
    if (!natural(&reader, &word->applied) || !natural(&reader, &word->settled)) return 0;
    if (!byte(&reader, 0xc2)) return 0; /* an emergency */
    word->held.at = reader.at;
    if (!skip(&reader)) return 0;
    word->held.bytes = (size_t)(reader.at - word->held.at);
    word->closings.at = reader.at;
    if (!skip(&reader)) return 0;
    word->closings.bytes = (size_t)(reader.at - word->closings.at);
    return reader.at == reader.end;
}

/* Sessions.fresh. */
static int is_fresh(const Columns *columns, int pid, int64_t sequence) {
    int64_t newest = columns->newest[pid], ahead = sequence - newest;
    uint64_t *seen = columns->seen + (size_t)pid * WORDS, bit = (uint64_t)1 << sequence % 64;
    if (-ahead >= WINDOW) return 0;
    if (ahead > 0) {
        int64_t block = newest / 64, last = sequence / 64;
        if (last - block > WORDS) block = last - WORDS;
        while (block < last) seen[++block % WORDS] = 0;
        columns->newest[pid] = sequence;
    }
    uint64_t *place = seen + sequence / 64 % WORDS;
    if (*place & bit) return 0;
    *place |= bit;
    return 1;
}

/* Metrics.heard and Histograms.add. `delay`: not a number where it is not known. */
static void note(const Columns *columns, int pid, int64_t ahead, double delay, double now) {
    columns->received[pid]++;
    columns->expected[pid] += ahead;
    if (columns->expected[pid] > RECENT) {
        columns->expected[pid] /= 2;
        columns->received[pid] /= 2;
    }
    if (isfinite(delay)) {
        double place = delay > SHORTEST ? PER_OCTAVE * log2(delay / SHORTEST) : 0;
        columns->delays[(size_t)pid * BUCKETS + (place < BUCKETS ? (size_t)place : BUCKETS - 1)]++;
        if (delay > columns->most[pid]) columns->most[pid] = delay;
    }
    double silent = now - columns->heard[pid];
    columns->heard[pid] = now;
    if (columns->longest[pid] < silent && silent < INFINITY) columns->longest[pid] = silent;
}

/* Link._stamps, but for what the clock learns. */
static void learn(const Columns *columns, const Word *word, double local, double fleet) {
    int pid = word->pid;
    if (word->sent > columns->sent[pid]) {
        columns->sent[pid] = word->sent;
        columns->arrived[pid] = microseconds(local);
    }
    int64_t before = columns->round[pid];
    if (word->round <= before) return;
    columns->round[pid] = word->round;
    double delay = word->known ? fleet - (double)(word->sent + word->fleet) / 1e6 : NAN;
    note(columns, pid, before ? word->round - before : 1, delay, local);
}

static int is_later(const Lesson *one, const Lesson *other) {
    if (one->answered != other->answered) return one->answered > other->answered;
    return one->uttered != other->uttered ? one->uttered > other->uttered : one->heard > other->heard;
}

/* Link._exchanges: what the clock learns, which Python will see to; of each peer what it said last. */
static void teach(Gate *gate, const Word *word, double local) {
    Shown *shown = &gate->shown;
    int64_t at = 0, *lessons = gate->columns.lessons;
    if (!word->echoed || local < gate->columns.due[word->pid]) return;
    const Lesson lesson = {word->pid, word->sent, word->uttered, word->heard, word->known ? word->fleet : 0, word->known,
                           microseconds(local)};
    while (at < *lessons && shown->lesson[at].pid != word->pid) at++;
    if (at < *lessons && !is_later(&lesson, &shown->lesson[at])) return;
    *lessons += at == *lessons;
    shown->lesson[at] = lesson;
}

/* As gate.Usual. */
static uint8_t *tell(uint8_t *at, const Word *word) {
    *at++ = 0x96;
    *at++ = (uint8_t)word->pid;
    at = put(put(put(at, word->round), word->applied), word->settled);
    return copy(copy(at, &word->held), &word->closings);
}

size_t gate_size(void) { return sizeof(Gate); }
size_t gate_shown_size(void) { return sizeof(Shown); }
size_t gate_columns_size(void) { return sizeof(Columns); }

/* Of robot `own` among `robots`. `rows` has room for MOST_AT_ONCE datagrams of LARGEST bytes, and 32 for each. */
void gate_open(Gate *gate, int32_t robots, int32_t own, const Columns *columns, uint8_t *rows, const uint8_t *key,
               uint32_t key_bytes, const uint8_t *purpose) {
    memset(gate, 0, sizeof *gate);
    gate->robots = robots;
    gate->own = own;
    gate->columns = *columns;
    gate->shown.rows = rows;
    gate->voice.stamped.until = -INFINITY;
    prepare(&gate->keyed, key, key_bytes, purpose);
}

/* How words of this mission begin, up to their sender; nothing: none is usual. */
void gate_begin(Gate *gate, const uint8_t *common, int32_t bytes) {
    gate->common_bytes = bytes <= MOST_COMMON ? bytes : 0;
    memcpy(gate->common, common, (size_t)gate->common_bytes);
}

/* Boot and epoch of a peer, as they are encoded (TAIL bytes); otherwise there is none, and nothing of it is usual. */
void gate_adopt(Gate *gate, int32_t pid, const uint8_t *tail, int32_t bytes) {
    gate->peer[pid].adopted = bytes == TAIL;
    if (bytes == TAIL) memcpy(gate->peer[pid].tail, tail, TAIL);
}

/* The number of the present view. */
void gate_follow(Gate *gate, int64_t view) {
    if (view != gate->view) gate->shown.past = 1;
    gate->view = view;
    if (gate->ledger) gate->ledger->number[PRESENT] = view;
}

/* Where usual words are noted from now on; NULL: nowhere. */
void gate_attach(Gate *gate, Ledger *ledger) {
    gate->ledger = ledger;
    gate_follow(gate, gate->view);
}

/* Judge slots from the first of these on, after those before it: see gate_take. */
static void judge(Gate *gate, const uint8_t *slots, int32_t stride, const int32_t *lengths, int32_t first, int32_t count,
                  double local, double fleet) {
    Shown *shown = &gate->shown;
    if (!first) shown->others = shown->bytes = shown->count = shown->past = 0;
    uint8_t *at = shown->rows + (shown->count ? shown->bytes : 5);
    unsigned genuine = 0; /* bits, of this one and those that were looked at with it */
    for (int32_t i = first; i < count; i++, genuine >>= 1) {
        const uint8_t *slot = slots + (size_t)i * (size_t)stride;
        Word word;
        uint8_t verdict = OTHER;
        if ((i - first) % LANES == 0)
            genuine = are_genuine(&gate->keyed, slot, stride, lengths + i, count - i < LANES ? count - i : LANES);
        if (lengths[i] < 0) verdict = NOTHING;
        else if (lengths[i] > LIMIT) verdict = TOO_LONG;
        else if (!(genuine & 1)) verdict = FALSE;
        else if (read_word(gate, slot, lengths[i] - MAC_SIZE, &word))
            verdict = is_fresh(&gate->columns, word.pid, word.sequence) ? USUAL : REPLAYED;
        if (verdict == USUAL) {
            learn(&gate->columns, &word, local, fleet);
            teach(gate, &word, local);
            if (gate->ledger && ledger_note(gate->ledger, &word)) verdict = NOTED;
        }
        shown->verdict[i] = verdict;
        shown->others += verdict != USUAL && verdict != NOTHING && verdict != NOTED;
        if (verdict != USUAL) continue;
        at = tell(at, &word);
        shown->count++;
    }
    shown->rows[0] = 0xdd;
    for (int i = 0; i < 4; i++) shown->rows[1 + i] = (uint8_t)((uint32_t)shown->count >> (24 - 8 * i));
    shown->bytes = shown->count ? (int32_t)(at - shown->rows) : 0;
}

/* Judge what arrived: `count` slots, `stride` bytes apart, with so many bytes in each (negative: nothing); at `local`
   seconds of the robot's clock, which is `fleet` of the fleet's (not a number: not known). */
void gate_take(Gate *gate, const uint8_t *slots, int32_t stride, const int32_t *lengths, int32_t count, double local,
               double fleet) {
    judge(gate, slots, stride, lengths, 0, count, local, fleet);
}

/* Where the courier leaves what it receives. */
void gate_listen(Gate *gate, const uint8_t *slots, const int32_t *lengths, const int32_t *used, int32_t *judged) {
    gate->heard = (Heard){slots, lengths, used, judged};
    *judged = 0;
}

/* Judge what lies there and is not judged yet: see gate_take. */
void gate_look(Gate *gate) {
    const Heard *heard = &gate->heard;
    const Shown *shown = &gate->shown;
    judge(gate, heard->slots, LARGEST, heard->lengths, *heard->judged, *heard->used, shown->local, shown->fleet);
    *heard->judged = *heard->used;
}

/* How many members but oneself lack the next round. */
static int32_t awaited(const Ledger *ledger) {
    const int32_t own = ledger->own;
    return (int32_t)ledger->number[LACKING] - (ledger->incarnation[own] >= 0 && ledger->held[own] <= ledger->number[APPLIED]);
}

/* What words tell others to add to our clock for fleet time, in seconds; not a number: it is not known. */
static double told_offset(const Stamped *stamped) { return stamped->known ? (double)stamped->fleet / 1e6 : NAN; }

/* The courier's Judge: while it waits, what needs no thought is noted, and Python wakes when all is here that others close
   the next round with, when what it does next may be certain, or for all that is not usual. Of what it has not looked at
   yet there is no more than one view's. */
int32_t gate_judge(Gate *gate, int32_t first, int32_t used, double local) {
    const Ledger *ledger = gate->ledger;
    if (!ledger || (first && (gate->shown.others || gate->shown.bytes))) return -1;
    const int64_t needed = ledger->robots / 2, before = ledger->number[REACHED]; /* of others, for a majority */
    const int32_t lacking = awaited(ledger);
    const Heard *heard = &gate->heard;
    judge(gate, heard->slots, LARGEST, heard->lengths, first, used, local, local + told_offset(&gate->voice.stamped));
    *heard->judged = used;
    if (gate->shown.others || gate->shown.bytes) return -1;
    if (!lacking || (before < needed && ledger->number[REACHED] >= needed)) return 0;
    return awaited(ledger);
}

/* How own words begin in this mission, up to their sequence number; nothing: none is said here. */
void voice_introduce(Gate *gate, const uint8_t *begin, int32_t bytes) {
    gate->voice.bytes = bytes <= MOST_BEGIN ? bytes : 0;
    memcpy(gate->voice.begin, begin, (size_t)gate->voice.bytes);
}

/* Where the last own word lies. */
const uint8_t *voice_said(const Gate *gate) { return gate->voice.said; }

size_t voice_stamped_size(void) { return sizeof(Stamped); }

/* Where the stamps of own words lie. */
Stamped *voice_stamped(Gate *gate) { return &gate->voice.stamped; }

/* Say a word, see compose; with the closing of round `own` that lies in the ledger, if it is not 0. How long it is with
   its MAC; 0: that is not possible here. */
static int32_t say(Gate *gate, const Text *stamps, const uint8_t *fields, int32_t bytes, const Ledger *ledger, int64_t own) {
    uint8_t *said = gate->voice.said;
    Text row;
    if (own && (!ledger || !ledger_row(ledger, ledger->own, own, &row))) return 0;
    const int32_t length = compose(&gate->voice, stamps, fields, bytes, own ? &row : NULL);
    if (length) make_mac(&gate->keyed, said, length, said + length);
    return length ? length + MAC_SIZE : 0;
}

/* The same of `fields` with stamps. */
int32_t voice_say(Gate *gate, const uint8_t *fields, int32_t bytes, const Ledger *ledger, int64_t own) {
    const Text none = {fields, 0};
    return say(gate, &none, fields, bytes, ledger, own);
}

/* By whom own words are sent, and what it wants to be called with; and the robot's clock (NULL: words come with stamps). */
void voice_couple(Gate *gate, Send *send, void *inbox, Clock *clock) {
    gate->voice.send = send;
    gate->voice.inbox = inbox;
    gate->voice.clock = clock;
}

/* Say a word and send it. `told`: an array of the place that it goes to, `own`, and the `fields` of compose, with stamps or
   without; the ledger is the gate's. Returns 0 or errno, as the courier does, and then what is stamped here has its number;
   or why nothing was sent. */
int32_t voice_send(Gate *gate, const uint8_t *told, int32_t bytes) {
    Voice *voice = &gate->voice;
    Reader reader = {told, told + (bytes > 0 ? bytes : 0)};
    int64_t place, own;
    uint8_t stamps[MOST_STAMPS];
    Text stamped = {stamps, 0};
    if (!voice->send || !byte(&reader, 0x93) || !natural(&reader, &place) || !natural(&reader, &own)) return NOT_POSSIBLE;
    if (reader.at < reader.end && *reader.at == 0x90 + SAID_FIELDS - STAMPS && !(stamped.bytes = stamp(voice, stamps)))
        return NOT_STAMPED;
    const int32_t length = say(gate, &stamped, reader.at, (int32_t)(reader.end - reader.at), gate->ledger, own);
    if (!length) return NOT_POSSIBLE;
    voice->stamped.sequence += stamped.bytes > 0;
    return voice->send(voice->inbox, (int32_t)place, voice->said, length);
}
