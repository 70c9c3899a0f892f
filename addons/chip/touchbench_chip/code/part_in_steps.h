/* What the taxels did in a part of a window, in steps of their readings; sums are exact. */
typedef $SUM touch_sum_t;
typedef $MOST touch_most_t;
typedef struct {
    int n;
    uint32_t squares[$TAXELS];
    touch_sum_t sum[$TAXELS];
    touch_most_t most[$TAXELS];
} touch_part_t;

