
#define TOUCH_UNKNOWN -1 /* label of a touch that is not named, as it is not sure enough */
#define TOUCH_REPORTED 1 /* news: an event is reported, its label is another one, it is over */
#define TOUCH_CHANGED 2
#define TOUCH_ENDED 3

/* Reasons not to trust the watch now, bits of touch_status; 0 for none. "Training" is the range of training streams. */
#define TOUCH_NOT_A_NUMBER 1 /* the last frame was refused: a reading that is not a number */
#define TOUCH_OUT_OF_RANGE 2 /* the last frame was refused: a reading above full scale, or below -TOUCH_NEGATIVE */
#define TOUCH_SATURATED 4    /* a tenth of the taxels at full scale in the last frame, or touches cut off below it */
#define TOUCH_NOISE 8        /* readings change more than in training, or taxels swing together */
#define TOUCH_STUCK 16       /* taxels that never change, dead or short-circuited, in the last touches */
#define TOUCH_RATE 32        /* frames repeat, or follow one another too fast or too slowly */
#define TOUCH_OFFSET 64      /* readings without touch are higher or lower than in training */
#define TOUCH_GAIN 128       /* readings without touch change less than in training */
#define TOUCH_UNLIKE 256     /* the last touches are unlike training: inverted, other order of taxels */

/* An event: its label so far, mean probability of the label, and frames seen when it was reported and when it ended.
   Frames are counted from touch_watch_init, modulo 2^32; end is 0 while the touch lasts. */
typedef struct {
    int label;
    float confidence;
    uint32_t reported, end;
} touch_event_t;

#define touch_watch_init touch_watch_init_$model

/* Begin to watch: once, at power-on. The state is all the memory that is needed; it holds that of a capture, too. */
int touch_watch_init(touch_watch_t *w);

/* Take a frame of an endless stream, as touch_push does: 0 without news, TOUCH_REPORTED, TOUCH_CHANGED or TOUCH_ENDED
   with news, which the event then tells, or a code. A frame that is refused changes only the status and its counts. A
   touch that is over before it was reported is news once, TOUCH_ENDED. News come TOUCH_DELAY frames after the frame that
   decides, as the work is spread over these; the times of an event are those of its news. */
int touch_watch(touch_watch_t *w, const float *frame, touch_event_t *event);

/* Labels whose confidence is below this, 0 to 1, are TOUCH_UNKNOWN: what is named is right more often then. The
   certificate of bench build tells how often at some confidences. */
int touch_set_confidence(touch_watch_t *w, float least);

/* So many frames are lost before the next one. Up to a second of them count as if the last frame were read again, and
   take as long; after more, a touch that lasts is over and the stream begins anew. Returns the last news. */
int touch_missed(touch_watch_t *w, uint32_t frames, touch_event_t *event);

/* Whether touches may be missed or named wrongly now: 0, or the bits of all reasons; or a code. counts may be NULL. */
int touch_status(const touch_watch_t *w, touch_counts_t *counts);

/* What a bit of the status means, from bit 0, in a word. */
const char *touch_reason(int bit);
